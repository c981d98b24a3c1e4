"""The driver of Basler cameras, with pylon's emulated camera."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.devices.pylon import PylonCamera
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.testing import CameraContract

pytestmark = pytest.mark.slow

SENSOR = CameraModel(exposures=(0.001, 0.01, 0.1))
SHAPE = (40, 48)
QUICK = {"timeout_seconds": 1.5}


def pictures(folder: Path, counts: np.ndarray) -> dict[str, str]:
    """Set the 16-bit counts of the emulated camera's pictures."""
    import cv2

    for name in ("a.png", "b.png"):
        assert cv2.imwrite(str(folder / name), counts)
    return {"TestImageSelector": "Off", "ImageFilename": str(folder), "ImageFileMode": "On"}


@pytest.fixture
def camera() -> Iterator[PylonCamera]:
    with PylonCamera(SENSOR, shape=SHAPE, **QUICK) as camera:
        yield camera


def fail(camera: PylonCamera, frames: int) -> None:
    """Make the next frames arrive damaged."""
    camera._handle.ForceFailedBufferCount.Value = frames
    camera._handle.ForceFailedBuffer.Execute()


def unplug(camera: PylonCamera) -> None:
    camera._handle.FirePnPCallbackValue.Value = 0
    camera._handle.FirePnPCallback.Execute()
    assert camera._handle.IsCameraDeviceRemoved()


class TestGreyCamera(CameraContract):
    def make_camera(self) -> PylonCamera:
        return PylonCamera(SENSOR, shape=SHAPE, nodes={"TestImageSelector": "Testimage1"}, **QUICK)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
@pytest.mark.parametrize("bayer", [None, "RGGB", "GRBG", "GBRG", "BGGR"])
def test_counts_arrive_bit_for_bit(bits: int, bayer: str | None, tmp_path: Path) -> None:
    counts = np.random.default_rng(0).integers(0, 2**16, SHAPE, dtype=np.uint16)
    sensor = replace(SENSOR, bits=bits, bayer=bayer)
    with PylonCamera(sensor, shape=SHAPE, nodes=pictures(tmp_path, counts), **QUICK) as camera:
        assert camera.describe()["pixel_format"].endswith(str(bits))
        bracket = camera.expose().reshape(3, *SHAPE)
    assert (bracket == counts >> (16 - bits)).all()


def test_automatic_functions_are_off_after_any_previous_settings() -> None:
    with PylonCamera(SENSOR, shape=SHAPE, gain_db=12, **QUICK) as camera:
        assert camera._handle.Gain.Value == pytest.approx(12, abs=0.1)
    with PylonCamera(SENSOR, shape=SHAPE, **QUICK) as camera:
        device = camera._handle
        assert device.GainAuto.Value == device.ExposureAuto.Value == "Off"
        assert (device.Gain.Value, device.Gamma.Value) == (0, 1)
        assert device.AcquisitionFrameRateEnable.Value is False
        for selector in device.TriggerSelector.Symbolics:
            device.TriggerSelector.Value = selector
            assert (device.TriggerMode.Value == "On") == (selector == "FrameStart")


def test_failed_frames_are_taken_again(
    camera: PylonCamera, caplog: pytest.LogCaptureFixture
) -> None:
    fail(camera, 1)
    assert camera.expose().shape == (3, *SHAPE, 1)
    assert camera.statistics == {"frames": 3, "failed": 1, "timed_out": 0, "reconnected": 0}
    assert "attempt 1 of 4: The buffer was incompletely grabbed" in caplog.text


def test_a_camera_that_always_fails_is_an_error_with_advice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(PylonCamera, "attempts", 1)
    with PylonCamera(SENSOR, shape=SHAPE, **QUICK) as camera:
        fail(camera, 10)
        with pytest.raises(
            CaptureError, match=r"0815-0000: no good frame of 0\.001 s in 1 attempts.*Check.*cable"
        ):
            camera.expose()
        assert camera.expose().shape == (3, *SHAPE, 1)


def test_a_late_frame_is_not_mistaken_for_the_next(tmp_path: Path) -> None:
    counts = np.full(SHAPE, 160, np.uint16)
    nodes = pictures(tmp_path, counts)
    with PylonCamera(SENSOR, shape=SHAPE, nodes=nodes, **QUICK) as camera:
        camera.expose()
        camera._handle.ExecuteSoftwareTrigger()  # its frame stays in the queue
        pictures(tmp_path, 2 * counts)
        camera._restart()
        assert (camera.expose() == 20).all()


def test_a_lost_camera_is_reconnected(
    camera: PylonCamera, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    camera.expose()
    unplug(camera)
    assert camera.expose().shape == (3, *SHAPE, 1)
    assert camera.statistics == {"frames": 6, "failed": 0, "timed_out": 0, "reconnected": 1}
    assert "camera 0815-0000 is reconnected" in caplog.text


def test_a_camera_that_stays_lost_is_an_error_with_advice(
    monkeypatch: pytest.MonkeyPatch, camera: PylonCamera
) -> None:
    unplug(camera)
    with monkeypatch.context() as patch:
        patch.setattr(camera, "_serial", "0815-9999")
        with pytest.raises(
            CaptureError, match=r"was lost and not reconnected in 4 attempts.*power, cable"
        ):
            camera.expose()
    assert camera.expose().shape == (3, *SHAPE, 1)
    assert camera.statistics["reconnected"] == 1


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"shape": (40, 30_000)}, r"refuses Width = 30000.*Valid: 1 to 4096"),
        (
            {"serial": "40001234"},
            r"40001234: 1 cameras respond: 0815.*camera\.options\.serial",
        ),
        ({"nodes": {"Gain": 99.0}}, "refuses Gain = 99"),
    ],
)
def test_refused_settings_are_explained(settings: dict[str, Any], expected: str) -> None:
    with pytest.raises(CaptureError, match=expected):
        PylonCamera(SENSOR, **{"shape": SHAPE, **QUICK, **settings})
    with pytest.raises(InputError, match="bits is 14; a GenICam camera has 8, 10, 12 or 16"):
        PylonCamera(replace(SENSOR, bits=14))
