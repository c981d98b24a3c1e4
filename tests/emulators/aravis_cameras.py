"""Aravis' virtual cameras, for tests of the GenICam driver."""

import ctypes
import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.devices.aravis import AravisCamera
from rfpipe.devices.aravis_library import call, load_aravis, release
from rfpipe.photometry import CameraModel

_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


def enable_fake() -> None:
    """Enable Aravis' in-process fake camera, whose serial number is 1."""
    library = load_aravis()[0]
    for name, result, *arguments in (
        ("enable_interface", None, ctypes.c_char_p),
        ("fake_device_get_fake_camera", ctypes.c_void_p, ctypes.c_void_p),
        ("fake_camera_set_trigger_frequency", None, ctypes.c_void_p, ctypes.c_double),
        ("fake_camera_set_fill_pattern", None, *(ctypes.c_void_p,) * 4),
    ):
        function = getattr(library, f"arv_{name}")
        function.restype, function.argtypes = result, arguments
    library.arv_enable_interface(b"Fake")


class FilledCamera(AravisCamera):
    """Aravis' fake camera with a given picture, (H, W) counts in the camera's pixel format."""

    def __init__(self, picture: np.ndarray, sensor: CameraModel, **options: Any) -> None:
        self._frame_bytes = picture.astype(np.uint8 if sensor.bits == 8 else "<u2").tobytes()
        self._fill = _FILL(self._copy)  # a reference, since the library calls it later
        enable_fake()
        super().__init__(sensor, **{"shape": picture.shape, **options, "serial": "1"})

    def _start(self, room: int = 0) -> None:
        fake = call("arv_fake_device_get_fake_camera", self._handle)
        call("arv_fake_camera_set_fill_pattern", fake, self._fill, None, None)
        call(
            "arv_fake_camera_set_trigger_frequency", fake, 1000.0
        )  # interval at which the camera checks for a trigger
        super()._start(room)

    def _copy(self, buffer: int, *_: Any) -> None:
        """Copy the picture into the library's buffer; called in a thread of the library."""
        data = call("arv_buffer_get_data", buffer, None)
        ctypes.memmove(data, self._frame_bytes, len(self._frame_bytes))


@contextmanager
def gige_camera(serial: str) -> Iterator[None]:
    """Run Aravis' fake GigE Vision camera on the loopback.

    It uses the port of the standard, and two cameras on one machine would receive each other's
    packets. A lock therefore allows one at a time on this machine.
    """
    with (Path(tempfile.gettempdir()) / "rfpipe-gige-vision.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        make = load_aravis()[0].arv_gv_fake_camera_new
        make.restype, make.argtypes = ctypes.c_void_p, (ctypes.c_char_p, ctypes.c_char_p)
        camera = make(b"127.0.0.1", serial.encode())
        try:
            yield
        finally:
            release(camera)
