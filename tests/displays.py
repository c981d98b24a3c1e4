"""The two kinds of display that a window or a bench can be tested on."""

import os

import pytest

OWN_NAME = f":{1000 + os.getpid() % 50_000}"
"""An X display that no other test takes while its server is away."""

X_SERVER = pytest.param("x server", marks=pytest.mark.needs("xvfb"))

DISPLAYS = [X_SERVER, "memory"]
