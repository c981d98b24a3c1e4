"""The driver of photo cameras, with libgphoto2's virtual camera and generated raw files."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.files.dng import dng_bytes

from rfpipe.devices import gphoto_library
from rfpipe.devices.gphoto import PhotoCamera, PhotoOptions
from rfpipe.devices.gphoto_library import Photo
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.testing import CameraContract

SENSOR = CameraModel(exposures=(0.01, 0.05))
SHAPE = (48, 60)
BLACK, WHITE = 600, 15_300
COUNTS = np.random.default_rng(0).integers(BLACK, WHITE, SHAPE).astype(np.uint16)
QUICK: dict[str, Any] = {"timeout_seconds": 1.0, "keep_pictures": True}


def put(folder: Path, counts: np.ndarray = COUNTS, seconds: float = 0.0, **levels: Any) -> None:
    """Make a raw file the next picture of the virtual camera."""
    known = {"bayer": "GRBG", "black": BLACK, "white": WHITE, **levels}
    (folder / "raw.jpg").write_bytes(dng_bytes(counts, seconds, **known))


@pytest.fixture(autouse=True)
def _raw_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Configure libgphoto2's virtual camera, which takes the first picture in a folder."""
    ports = Path(gphoto_library.load_gphoto2().__file__).parent / "libgphoto2" / "vusb"
    monkeypatch.setenv("IOLIBS", str(ports))
    monkeypatch.setenv("VCAMERADIR", str(tmp_path))
    put(tmp_path)


def camera_of(sensor: CameraModel = SENSOR, **options: Any) -> PhotoCamera:
    return PhotoCamera(sensor, **{**QUICK, **options})


class TestPhotoCamera(CameraContract):
    def make_camera(self) -> PhotoCamera:
        return camera_of()


def test_counts_equal_the_raw_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    released, release = [], Photo.release

    def look(photo: Photo) -> None:
        released.append(photo.get("shutterspeed"))
        release(photo)

    with camera_of() as camera:
        monkeypatch.setattr(Photo, "release", look)
        assert (camera.expose() == COUNTS).all()
        assert camera.channels == 3
    assert released == ["0.0100s", "0.0500s"]


def test_counts_above_the_white_level_are_saturated(tmp_path: Path) -> None:
    bright = COUNTS.copy()
    bright[4:10, 4:10] = WHITE + 200  # noise above the white level, within 14 bits
    put(tmp_path, bright)
    with camera_of() as camera:
        frames = camera.expose()
        assert frames.max() == WHITE
        merged = camera.sensor.merge(frames[None], np.full(frames.shape, BLACK, np.float32))
    # with full scale at 2^14 - 1 they would pass for light
    assert merged.saturated == np.count_nonzero(bright >= np.ceil(0.98 * WHITE))


def test_a_region_of_the_sensor_is_cropped(tmp_path: Path) -> None:
    with camera_of(shape=(20, 30), offset=(4, 8)) as camera:
        assert camera.shape == (20, 30)
        assert (camera.expose() == COUNTS[4:24, 8:38]).all()
    with pytest.raises(ValueError, match="even numbers"):
        PhotoOptions(offset=(1, 0))


def test_exposures_are_the_nearest_times_of_the_camera(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    sensor = replace(SENSOR, exposures=(1 / 64, 0.1, 1.0))
    with camera_of(sensor) as camera:
        assert camera.describe()["shutter"] == ["0.0200s", "0.1000s", "1.0000s"]
        assert camera.sensor.exposures == pytest.approx((2 ** (-17 / 3), 2 ** (-10 / 3), 1))
    assert "takes 0.0200s (0.0196863 s) for an exposure of 0.015625 s" in caplog.text
    with pytest.raises(InputError, match=r"two times for which the camera's nearest is 1\.0000s"):
        camera_of(replace(SENSOR, exposures=(1.0, 1.1)))


def test_a_picture_that_is_not_raw_names_the_setting(tmp_path: Path) -> None:
    (tmp_path / "raw.jpg").write_bytes(b"\xff\xd8" + bytes(5_000))
    expected = r"can't be read as a raw file.*camera\.options\.settings"
    with pytest.raises(CaptureError, match=expected):
        camera_of()


def test_a_picture_of_another_exposure_is_taken_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    put(tmp_path, seconds=0.01)
    wrong = iter([0.05, 0.01])
    with camera_of(replace(SENSOR, exposures=(0.01,))) as camera:
        monkeypatch.setattr(
            camera, "_before_trigger", lambda _: put(tmp_path, seconds=next(wrong, 0.01))
        )
        assert (camera.expose() == COUNTS).all()
        assert camera.statistics["failed"] == 1
    assert "metadata record an exposure of 0.05 s" in caplog.text


def test_a_lost_camera_is_reconnected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    release, failures = Photo.release, iter([True])

    def gone(photo: Photo) -> None:
        if next(failures, False):
            raise gphoto_library.load_gphoto2().GPhoto2Error(-7)
        release(photo)

    with camera_of() as camera:
        monkeypatch.setattr(Photo, "release", gone)
        assert (camera.expose() == COUNTS).all()
        assert camera.statistics == {"frames": 2, "failed": 0, "timed_out": 0, "reconnected": 1}


def test_settings_are_written_or_refused(tmp_path: Path) -> None:
    with camera_of(settings={"f-number": "f/8"}) as camera:
        assert camera._handle.get("f-number") == "f/8"
        assert camera._handle.get("autofocus") == "Off"
    with pytest.raises(CaptureError, match=r"f-number can't be f/7; it is one of f/2\.8"):
        camera_of(settings={"f-number": "f/7"})
    with pytest.raises(CaptureError, match="has no setting whitebalance"):
        camera_of(settings={"whitebalance": "Daylight"})
