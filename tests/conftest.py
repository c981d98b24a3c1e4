"""Shared by all tests: examples are the same in every run, and loggers as they were before each."""

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

_WORKFLOW = Path(__file__).parent / "workflow"

_LOGGERS = (logging.getLogger(), logging.getLogger("rfpipe"), logging.getLogger("rfpipe.server"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole runs come first: they are the longest, and what comes last can be shared out finely.

    The kernels that their jobs compile are then there for the tests in process.
    """
    items.sort(key=lambda item: _WORKFLOW not in item.path.parents)


@pytest.fixture(autouse=True)
def _loggers_as_before() -> Iterator[None]:
    """Commands and servers set up their logs: one that a test runs in process leaves none."""
    before = [(logger.level, list(logger.handlers), logger.propagate) for logger in _LOGGERS]
    yield
    for logger, (level, handlers, propagate) in zip(_LOGGERS, before, strict=True):
        logger.setLevel(level)
        logger.handlers = handlers
        logger.propagate = propagate
