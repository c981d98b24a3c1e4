"""Aravis' virtual cameras, for the tests of its driver."""

import fcntl
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.photometry import CameraModel
from rfpipe_devices.aravis import PreparedCamera
from rfpipe_devices.aravis_library import call, release


class FilledCamera(PreparedCamera):
    """Aravis' fake camera before a picture of one's own, (H, W) counts as the format has them."""

    def __init__(self, picture: np.ndarray, sensor: CameraModel, **options: Any) -> None:
        self.put(picture, sensor.bits)
        super().__init__(sensor, shape=picture.shape, **options)


@contextmanager
def gige_camera(serial: str) -> Iterator[None]:
    """Run Aravis' fake GigE Vision camera on the loopback.

    Its port is the standard's, and of two on a machine either gets the other's packets: one at a
    time, whichever worker, or other run of the tests, has it.
    """
    with (Path(tempfile.gettempdir()) / "rfpipe-gige-vision.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        camera = call("arv_gv_fake_camera_new", b"127.0.0.1", serial.encode())
        try:
            yield
        finally:
            release(camera)
