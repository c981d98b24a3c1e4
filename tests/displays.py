"""The two kinds of display that a window or a bench can be tested on."""

import os
import shutil

import pytest

OWN_NAME = f":{1000 + os.getpid() % 50_000}"
"""An X display that no other test takes while its server is away."""

X_SERVER = pytest.param("x server", marks=pytest.mark.xvfb)

DISPLAYS = [X_SERVER, "memory"]


def need_xvfb() -> None:
    """Skip a test marked `xvfb` where there is none, or fail where one is required."""
    if shutil.which("Xvfb") is None:
        if os.environ.get("RFPIPE_REQUIRE_XVFB"):
            pytest.fail("RFPIPE_REQUIRE_XVFB is set, but there is no Xvfb: apt-get install xvfb")
        pytest.skip("a test of a real X server; to run it: apt-get install xvfb")
