"""A user-defined projector, camera and rig in one file.

The scene is a simulated desk: the camera's picture is the projector's picture times an albedo.
Drivers of real devices look the same, and call a manufacturer's library in `show` and `expose`.
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
    """A projector that lights the desk."""

    class Options(Settings):
        """Options in the settings' file, validated before the projector is created."""

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
    """A camera of the desk; its `sensor` comes from the settings and the calibration."""

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
    """The projector and the camera as one rig."""

    def __init__(self, sensor: CameraModel, brightness=1.0):
        super().__init__(DeskProjector(brightness), DeskCamera(sensor))
