"""Virtual cameras of the drivers' libraries, for their tests."""

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.bench_cameras import PreparedCamera
from rfpipe.rigs.cameras.aravis_library import call, load_aravis, release
from rfpipe.rigs.cameras.gphoto_library import load_gphoto2


def need_aravis() -> None:
    """Skip a test where Aravis isn't installed, or fail where it is required."""
    _need(load_aravis, "RFPIPE_REQUIRE_ARAVIS", "apt-get install libaravis-0.8-0")


def need_gphoto2() -> None:
    """Skip a test where gphoto2 isn't installed, or fail where it is required."""
    _need(load_gphoto2, "RFPIPE_REQUIRE_GPHOTO2", "pip install rfpipe[gphoto2]")


def _need(load: Any, variable: str, advice: str) -> None:
    try:
        load()
    except CaptureError as error:
        if os.environ.get(variable):
            pytest.fail(f"{variable} is set, but: {error}")
        pytest.skip(f"needs a camera's library; to run it: {advice}")


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
