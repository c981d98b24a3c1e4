"""Undisturbed runs, made once and shared by all workers."""

from __future__ import annotations

import fcntl
import shutil
import signal
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.workflow.harness import (
    CONFIG,
    DUAL,
    GLASS,
    LONG,
    OWN_METHODS,
    TINY,
    Workflow,
)

_EXAMPLES = Path(__file__).parents[1] / "examples"

# A shell starts what runs in the background with SIGINT ignored, and programs inherit that: the
# tests of Ctrl-C need it as a terminal has it.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def undisturbed(shared: Path, kernels: None) -> Workflow:
    """Run `tiny` by symmetric and dual photography, and `long` by brute force; left as it is."""
    return _once(shared / "undisturbed", lambda workflow: workflow.run(*TARGETS))


TARGETS = (TINY, DUAL, LONG)


@pytest.fixture(scope="session")
def of_ones_own(shared: Path, kernels: None) -> Workflow:
    """Run a scene and a method of the user's own beside rfpipe's, up to the report."""

    def run(workflow: Workflow) -> str:
        for name in ("column_scan.py", "frosted_glass.py"):
            shutil.copy(_EXAMPLES / name, workflow.folder)
        workflow.configure(
            scenes={"tiny": CONFIG["scenes"]["tiny"], "glass": GLASS},
            methods={**OWN_METHODS, "brute_force": {}},
            camera=None,
        )
        return workflow.run()

    return _once(shared / "of_ones_own", run)


def _once(folder: Path, run: Callable[[Workflow], str]) -> Workflow:
    """Have one of the workers run something that the others wait for."""
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            (folder / "output").write_text(run(Workflow(folder)))
            (folder / "complete").touch()
    return Workflow(folder)


@pytest.fixture
def copy(undisturbed: Workflow, tmp_path: Path) -> Workflow:
    """A complete run to disturb."""
    return undisturbed.copy_to(tmp_path / "copy")
