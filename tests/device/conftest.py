"""Displays and cameras for the tests of devices: an X server or an array, an emulated camera."""

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.displays import DISPLAYS

from rfpipe.rigs.cameras.bracket import BracketCamera
from rfpipe.rigs.displays import VirtualDisplay, XServer, memory_display

BracketCamera.reconnect_seconds = 0.0  # virtual cameras are back at once
os.environ["PYLON_CAMEMU"] = "1"  # before pypylon is loaded


@pytest.fixture(scope="module")
def x_display() -> Iterator[VirtualDisplay]:
    """An X server's display of 120 x 160 pixels; for tests that need `xvfb`."""
    with XServer((120, 160)) as server:
        yield server


@pytest.fixture(scope="module", params=DISPLAYS)
def display(request: pytest.FixtureRequest) -> Iterator[VirtualDisplay]:
    """A display of 120 x 160 pixels, of either kind."""
    if request.param == "x server":
        yield request.getfixturevalue("x_display")
    else:
        with memory_display((120, 160)) as made:
            yield made


@pytest.fixture(scope="module", params=DISPLAYS)
def either_display(request: pytest.FixtureRequest) -> Iterator[str]:
    """The kind of display that benches of this machine have: that they find is arranged."""
    if request.param == "x server":
        yield request.param
    else:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("PATH", str(Path(sys.executable).parent))
            assert shutil.which("Xvfb") is None
            yield request.param
