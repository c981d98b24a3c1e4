"""Displays and cameras for the tests of devices: an X server in memory, an emulated camera."""

import os
from collections.abc import Iterator

import pytest

from rfpipe.rigs.xvfb import VirtualDisplay, xvfb

os.environ["PYLON_CAMEMU"] = "1"  # before pypylon is loaded


@pytest.fixture(scope="module")
def display() -> Iterator[VirtualDisplay]:
    """A display of 120 x 160 pixels."""
    with xvfb((120, 160)) as server:
        yield server
