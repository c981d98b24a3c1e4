"""Fixtures and settings of all tests: order, required programs, compiled kernels and loggers."""

import fcntl
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from tests.machine import needs

# One BLAS thread per worker: several workers with a thread per core slow each other down.
# Must be set before numpy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Idle kernel threads sleep instead of spinning, which leaves the cores to other workers.
# Must be set before the kernels start their threads.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

settings.register_profile("rfpipe", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("rfpipe")

_HERE = Path(__file__).parent

_WITHOUT_KERNELS = (_HERE / "server", _HERE / "device", _HERE / "release")
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
    """Sort the tests: without kernels first, then the workflow's long ones, then all others.

    One worker compiles the kernels while the others run the first tests. Short tests at the end
    keep all workers busy. Adds the ``needs`` markers and the `kernels` fixture.
    """
    items.sort(key=_priority)
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        for name in needs.HINTS:
            if name in item.fixturenames:
                item.add_marker(pytest.mark.needs(name))
        if item.path.parent not in _WITHOUT_KERNELS:
            item.fixturenames.insert(0, "kernels")


def _priority(item: pytest.Item) -> int:
    """Position of a test in the order; lower runs earlier."""
    folder = item.path.parent
    return 0 if folder in _WITHOUT_KERNELS else 1 if folder == _WORKFLOW else 2


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    # not in a fixture, so that the summary has one line for all skipped tests of a program
    for mark in item.iter_markers("needs"):
        needs.need(*mark.args)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A headless Chromium browser."""
    from playwright.sync_api import sync_playwright

    path = needs.program("chromium")
    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="session")
def validators() -> str:
    """Path of the interpreter with the validators of published runs."""
    return str(needs.VALIDATORS)


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A temporary folder that all workers share."""
    base = tmp_path_factory.getbasetemp()
    return base.parent if base.name.startswith("popen-") else base


@pytest.fixture(scope="session")
def kernels(shared: Path) -> None:
    """Compile the kernels in one worker, which takes a minute, while the others wait.

    Without parallel workers each test compiles its kernels itself.
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


@pytest.fixture(scope="module")
def quick_fonts() -> Iterator[None]:
    """Embed fonts in PDF files as Type 3, which takes half the time of a subset of TrueType."""
    from rfpipe.report import page

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page, "_PDF_STYLE", {"pdf.fonttype": 3})
        yield


@pytest.fixture(autouse=True)
def _restored_loggers() -> Iterator[None]:
    """Restore the loggers that commands and servers configure in the process of the tests."""
    before = [(logger.level, list(logger.handlers), logger.propagate) for logger in _LOGGERS]
    yield
    for logger, (level, handlers, propagate) in zip(_LOGGERS, before, strict=True):
        logger.setLevel(level)
        logger.handlers = handlers
        logger.propagate = propagate
