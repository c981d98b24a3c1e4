"""A projector, a camera and a whole rig of one's own, in one file.

They stand before a desk that exists in this process alone: the camera sees what the projector
shows, times an albedo. Drivers of real devices look the same, with a maker's library in `show` and
`expose`.
"""

from typing import Any

import numpy as np
from pydantic import Field

from rfpipe.config.base import Settings
from rfpipe.photometry import CameraModel
from rfpipe.rigs import DeviceRig
from rfpipe.rigs.devices import check_picture

SHAPE = (24, 30)
DESK: dict[str, Any] = {"light": np.zeros(SHAPE, np.float32), "pictures": 0}


class DeskProjector:
    """Lights the desk."""

    class Options(Settings):
        """What the settings' file may say of it: checked, with descriptions, before it is made."""

        brightness: float = Field(1.0, gt=0, le=1, description="Light of a pixel, 0 to 1.")

    shape = SHAPE

    def __init__(self, brightness=1.0):
        self.brightness = brightness
        self.closed = False

    def show(self, picture):
        if self.closed:
            from rfpipe.errors import CaptureError

            raise CaptureError("the desk's projector is closed")
        DESK["light"] = self.brightness * check_picture(picture, self.shape)

    def describe(self):
        return {"kind": "desk projector", "brightness": self.brightness}

    def close(self):
        self.closed = True


class DeskCamera:
    """Looks at the desk. It asks for `sensor`, and gets what settings and calibration say of it."""

    shape = SHAPE
    channels = 1

    def __init__(self, sensor: CameraModel, seed=0):
        self.sensor = sensor
        self.seed = seed
        self.closed = False

    def expose(self):
        if self.closed:
            from rfpipe.errors import CaptureError

            raise CaptureError("the desk's camera is closed")
        DESK["pictures"] += 1
        albedo = 0.3 + 0.5 * (np.indices(SHAPE).sum(0) % 5 == 0)
        radiance = (albedo * DESK["light"]).astype(np.float32)[..., None]
        return self.sensor.expose(radiance, self.seed, (0, DESK["pictures"]))

    def describe(self):
        return {"kind": "desk camera", "seed": self.seed, **self.sensor.describe()}

    def close(self):
        self.closed = True


class DeskRig(DeviceRig):
    """Both as a whole."""

    def __init__(self, sensor: CameraModel, brightness=1.0):
        super().__init__(DeskProjector(brightness), DeskCamera(sensor))
