"""The built release."""

from pathlib import Path

import pytest
from tests.machine import needs


@pytest.fixture(scope="session")
def release() -> Path:
    """The wheel in ``dist``; the sdist is beside it."""
    (wheel,) = needs.DIST.glob("*.whl")
    return wheel
