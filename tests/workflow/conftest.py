"""Undisturbed runs, made once and shared by all workers."""

from __future__ import annotations

import fcntl
import logging
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.workflow.harness import DUAL, LONG, TINY, Workflow

# A shell starts what runs in the background with SIGINT ignored, and programs inherit that: the
# tests of Ctrl-C need it as a terminal has it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def undisturbed(shared: Path, kernels: None) -> Workflow:
    """Run `tiny` by symmetric and dual photography and `long` by brute force; leave it as it is."""
    folder = shared / "undisturbed"
    with (shared / "undisturbed.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            workflow = Workflow(folder)
            (folder / "output").write_text(workflow.run(TINY, DUAL, LONG))
            (folder / "complete").touch()
    return Workflow(folder)


@pytest.fixture
def copy(undisturbed: Workflow, tmp_path: Path) -> Workflow:
    """A complete run to disturb."""
    return undisturbed.copy_to(tmp_path / "copy")


@pytest.fixture
def closed_logs() -> Iterator[None]:
    """Close the logs that stages leave open where they fail, as their job ends then."""
    log = logging.getLogger("rfpipe")
    before = list(log.handlers)
    yield
    for handler in set(log.handlers) - set(before):
        log.removeHandler(handler)
        handler.close()
