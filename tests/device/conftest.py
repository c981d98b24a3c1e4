"""Settings for the tests of devices."""

import os

from rfpipe.devices.bracket import BracketCamera

BracketCamera.reconnect_seconds = 0.0  # virtual cameras reconnect without delay
os.environ["PYLON_CAMEMU"] = "1"  # before pypylon is loaded
