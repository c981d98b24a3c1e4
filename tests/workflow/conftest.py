"""Finished runs, made once and shared by all workers of the tests."""

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

# Shells start background programs with SIGINT ignored, and child processes inherit this. The tests
# of Ctrl-C need the default handler.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def undisturbed(shared: Path, kernels: None) -> Workflow:
    """A run of `tiny` by symmetric and dual photography and of `long` by brute force; read only."""
    return _once(shared / "undisturbed", lambda workflow: workflow.run(*TARGETS))


TARGETS = (TINY, DUAL, LONG)


@pytest.fixture(scope="session")
def of_ones_own(shared: Path, kernels: None) -> Workflow:
    """A run with a user-defined scene and method and with rfpipe's own, up to the report."""

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
    """Run the workflow in one worker of the tests, while the others wait."""
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            (folder / "output").write_text(run(Workflow(folder)))
            (folder / "complete").touch()
    return Workflow(folder)


@pytest.fixture
def copy(undisturbed: Workflow, tmp_path: Path) -> Workflow:
    """A copy of the undisturbed run, which tests may change."""
    return undisturbed.copy_to(tmp_path / "copy")
