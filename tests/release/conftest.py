"""The built release."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.machine import needs


@pytest.fixture(scope="session")
def release() -> Path:
    """The wheel in ``dist``; the sdist is beside it."""
    (wheel,) = needs.DIST.glob("*.whl")
    return wheel


@pytest.fixture
def scratch(tmp_path: Path) -> Iterator[Path]:
    """A temporary folder that is removed after the test, since an environment has 1 GB."""
    yield tmp_path
    shutil.rmtree(tmp_path)
