"""Shared by all tests: examples are the same in every run, and loggers as they were before each."""

import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Two workers whose BLAS takes both cores each wait for one another. Read when numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# For the same reason threads of kernels that wait for one another sleep: to spin takes the cores
# from those who have work. Read when the kernels' threads are started.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

settings.register_profile("rfpipe", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("rfpipe")

_HERE = Path(__file__).parent

# The longest by far: with it one worker compiles the kernels while others do what needs none.
_FIRST = _HERE / "workflow" / "test_figures.py"
_WITHOUT_KERNELS = (_HERE / "server", _HERE / "device")
_WORKFLOW = _HERE / "workflow"

_LOGGERS = (logging.getLogger(), logging.getLogger("rfpipe"), logging.getLogger("rfpipe.server"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole runs come early: they are the longest, and what comes last can be shared out finely.

    But for one, all come after what needs no kernels, while these are compiled: each of a run's
    jobs would compile its own.
    """
    items.sort(key=_place)
    for item in items:
        if item.path.parent not in _WITHOUT_KERNELS and isinstance(item, pytest.Function):
            item.fixturenames.insert(0, "kernels")


def _place(item: pytest.Item) -> int:
    """Tell when a test is due; workers take whole files, whose tests share what is made once."""
    if item.path == _FIRST:
        return 0
    folder = item.path.parent
    return 1 if folder in _WITHOUT_KERNELS else 2 if folder == _WORKFLOW else 3


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that all workers have in common."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if base.name.startswith("popen-") else base


@pytest.fixture(scope="session")
def kernels(shared: Path) -> None:
    """The kernels, compiled by one worker: it takes a minute, and as much again for each at once.

    A worker alone compiles what its tests need.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        return
    from tests.kernels import compile_kernels

    folder = shared / "kernels"
    with (shared / "kernels.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            folder.mkdir()
            compile_kernels(folder)


@pytest.fixture(autouse=True)
def _loggers_as_before() -> Iterator[None]:
    """Commands and servers set up their logs: one that a test runs in process leaves none."""
    before = [(logger.level, list(logger.handlers), logger.propagate) for logger in _LOGGERS]
    yield
    for logger, (level, handlers, propagate) in zip(_LOGGERS, before, strict=True):
        logger.setLevel(level)
        logger.handlers = handlers
        logger.propagate = propagate
