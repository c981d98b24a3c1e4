"""Undisturbed runs, made once and shared by all workers."""

from __future__ import annotations

import fcntl
import signal
from pathlib import Path

import pytest
from tests.workflow.harness import DUAL, LONG, STUDIES, TINY, Workflow

# A shell starts what runs in the background with SIGINT ignored, and programs inherit that: the
# tests of Ctrl-C need it as a terminal has it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def undisturbed(shared: Path, kernels: None) -> Workflow:
    """Run `tiny` by symmetric and dual photography, `long` by brute force, and the studies.

    It is left as it is.
    """
    folder = shared / "undisturbed"
    with (shared / "undisturbed.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            workflow = Workflow(folder)
            (folder / "output").write_text(workflow.run(TINY, DUAL, LONG, *STUDIES))
            (folder / "complete").touch()
    return Workflow(folder)


@pytest.fixture
def copy(undisturbed: Workflow, tmp_path: Path) -> Workflow:
    """A complete run to disturb."""
    return undisturbed.copy_to(tmp_path / "copy")
