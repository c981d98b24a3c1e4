"""Shared by all tests: examples are the same in every run, and loggers as they were before each."""

import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from tests.machine import needs

# Two workers whose BLAS takes both cores each wait for one another. Read when numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# For the same reason threads of kernels that wait for one another sleep: to spin takes the cores
# from those who have work. Read when the kernels' threads are started.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

settings.register_profile("rfpipe", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("rfpipe")

_HERE = Path(__file__).parent

_WITHOUT_KERNELS = (_HERE / "server", _HERE / "device")
_WORKFLOW = _HERE / "workflow"

_hidden = needs.hide()

_LOGGERS = (
    logging.getLogger(),
    logging.getLogger("rfpipe"),
    logging.getLogger("rfpipe.server"),
    logging.getLogger("uvicorn.error"),
    logging.getLogger("uvicorn.access"),
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole runs come early: they are the longest, and what comes last can be shared out finely.

    They come after what needs no kernels: these are compiled meanwhile, by the worker that begins
    in the midst of all tests.
    """
    items.sort(key=_place)
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        for name in needs.HINTS:
            if name in item.fixturenames:
                item.add_marker(pytest.mark.needs(name))
        if item.path.parent not in _WITHOUT_KERNELS:
            item.fixturenames.insert(0, "kernels")


def _place(item: pytest.Item) -> int:
    """Tell when a test is due."""
    folder = item.path.parent
    return 0 if folder in _WITHOUT_KERNELS else 1 if folder == _WORKFLOW else 2


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    # not in a fixture: the summary then has one line of all of them
    for mark in item.iter_markers("needs"):
        needs.need(*mark.args)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A browser without a window."""
    from playwright.sync_api import sync_playwright

    path = needs.program("chromium")
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="session")
def validators() -> str:
    """The interpreter that has the programs that published runs are checked by."""
    return str(needs.VALIDATORS)


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
    from tests.machine.kernels import compile_kernels

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
