"""The cameras of the bench in software besides pylon's: drivers on their virtual devices."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np

from rfpipe.errors import InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.bench import Scenery, View
from rfpipe.rigs.cameras.aravis import AravisCamera
from rfpipe.rigs.cameras.aravis_library import call

__all__ = ["AravisBenchCamera"]

FAKE_SERIAL = "1"
"""Of Aravis' fake camera."""

FAKE_HERTZ = 1000.0
"""How often it looks for a trigger."""

_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


class AravisBenchCamera(AravisCamera):
    """Aravis' fake camera, each of its pictures made when it is triggered.

    Parameters
    ----------
    scenery : Scenery
    sensor : CameraModel
        What the rig believes of the camera; its exposures are set, its noise is not used.
    settings
        As `AravisCamera` has them; serial and shape are the bench's.

    Raises
    ------
    CaptureError
        When Aravis is missing.
    InputError
        When its fake camera has no such pixel format.
    """

    def __init__(self, scenery: Scenery, sensor: CameraModel, **settings: Any) -> None:
        if scenery.camera.bits != (16 if sensor.bayer is None else 8):
            raise InputError(
                f"sensor.bits is {scenery.camera.bits}; the bench with camera.driver aravis, which "
                "is Aravis' fake camera, has Mono16, or a colour mosaic of 8 bits"
            )
        self._view = View(scenery)
        self._next = b""
        self._fill = _FILL(self._copy)  # kept, as the library calls it
        own = {"serial": FAKE_SERIAL, "fake": True, "shape": scenery.path.camera_shape}
        super().__init__(sensor, **{**settings, **own})

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"kind": "bench of aravis"} | self._view.scenery.describe()

    def _start(self) -> None:
        fake = call("arv_fake_device_get_fake_camera", self._device)
        call("arv_fake_camera_set_fill_pattern", fake, self._fill, None, None)
        call("arv_fake_camera_set_trigger_frequency", fake, FAKE_HERTZ)
        super()._start()

    def _before_trigger(self, exposure: float) -> None:
        counts = self._view.frame(exposure)
        dtype = np.uint8 if self._view.scenery.camera.bits == 8 else "<u2"
        self._next = counts.astype(dtype).tobytes()

    def _copy(self, buffer: int, *_: Any) -> None:
        """Fill the library's buffer with the picture; is called by a thread of its own."""
        ctypes.memmove(call("arv_buffer_get_data", buffer, None), self._next, len(self._next))
