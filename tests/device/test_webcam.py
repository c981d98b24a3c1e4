"""The driver of webcams, on image sequences that OpenCV opens as a device, and on UVC controls."""

from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from rfpipe.devices.webcam import Webcam
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.testing import CameraContract

SENSOR = CameraModel(exposures=(0.03,), bits=8, black_level_counts=2)
SHAPE = (24, 30)
PICTURE = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
QUICK: dict[str, Any] = {"skip_frames": 1}


def sequence(folder: Path, frames: int = 40, picture: np.ndarray = PICTURE) -> str:
    """Write an image sequence that OpenCV opens as a device with this number of frames."""
    for number in range(frames):
        assert cv2.imwrite(str(folder / f"{number:04d}.png"), picture[..., ::-1])
    return str(folder / "%04d.png")


def webcam(folder: Path, sensor: CameraModel = SENSOR, **options: Any) -> Webcam:
    return Webcam(sensor, device=sequence(folder), backend="images", **{**QUICK, **options})


class VirtualUvc:
    """A simulated V4L2 camera with controls and a delay.

    `late` frames that are on their way when the picture changes still show the old one, as a
    driver's buffers do. Exposure times are multiples of `step` ticks.
    """

    step = 1

    def __init__(self, frame: np.ndarray, late: int) -> None:
        self._frames = deque([frame])
        self._last, self._late = frame, late
        self._controls: dict[int, float] = {}

    def put(self, frame: np.ndarray) -> None:
        """Set the next frame of the camera."""
        self._frames.extend([self._last] * self._late + [frame])
        self._last = frame

    def isOpened(self) -> bool:  # noqa: N802
        """Return True if the camera is connected."""
        return True

    def grab(self) -> bool:
        """Take a frame without decoding it."""
        return self.read()[0]

    def read(self) -> tuple[bool, np.ndarray | None]:
        """Take a frame."""
        return (True, self._frames.popleft()) if self._frames else (False, None)

    def set(self, prop: int, value: float) -> bool:
        """Change a setting."""
        is_time = prop == cv2.CAP_PROP_EXPOSURE
        value = max(self.step, self.step * round(value / self.step)) if is_time else value
        self._controls[prop] = float(value)
        return True

    def get(self, prop: int) -> float:
        """Return a setting."""
        return self._controls.get(prop, 0.0)

    def getBackendName(self) -> str:  # noqa: N802
        """Return the name of the backend."""
        return "V4L2"

    def release(self) -> None:
        """Close the camera."""


class UvcCamera(Webcam):
    """A webcam whose exposure times are set: the light in its frames is in proportion."""

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, **{**QUICK, **options})

    def _opened(self) -> VirtualUvc:
        return VirtualUvc(np.zeros((*SHAPE, 3), np.uint8), self._options.skip_frames)

    def _before_trigger(self, exposure: float) -> None:
        ticks = self._handle.get(cv2.CAP_PROP_EXPOSURE)
        self._handle.put(np.full((*SHAPE, 3), round(ticks / 20), np.uint8))


class TestUvcCamera(CameraContract):
    def make_camera(self) -> Webcam:
        return UvcCamera(replace(SENSOR, exposures=(0.02, 0.1, 0.5)))


def test_counts_equal_the_frames_in_rgb_order(tmp_path: Path) -> None:
    with webcam(tmp_path) as camera:
        assert (camera.expose()[0] == PICTURE).all()
    with webcam(tmp_path, channels=1) as camera:
        assert (camera.expose()[0, ..., 0] == PICTURE[..., 1]).all()


def test_a_warning_names_functions_that_cannot_be_switched_off(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with webcam(tmp_path) as camera:
        assert camera.adapts[:3] == (
            "automatic exposure", "automatic white balance", "autofocus",
        )  # fmt: skip
    assert "webcams process their 8-bit frames" in caplog.text
    assert "its exposure time can't be set and is unknown" in caplog.text


def test_automatic_functions_are_switched_off(caplog: pytest.LogCaptureFixture) -> None:
    with UvcCamera(SENSOR) as camera:
        assert camera.adapts == ()
        assert camera._handle.get(cv2.CAP_PROP_AUTO_EXPOSURE) == 1  # manual, of V4L2
        assert camera._handle.get(cv2.CAP_PROP_GAMMA) == 100
    assert "could not be switched off" not in caplog.text


def test_exposures_are_in_ticks_of_v4l2() -> None:
    with UvcCamera(replace(SENSOR, exposures=(1 / 64, 0.1, 0.5))) as camera:
        assert camera.sensor.exposures == (0.0156, 0.1, 0.5)
        means = camera.expose().reshape(3, -1).mean(axis=1)
    assert means.tolist() == [8, 50, 250]  # frames on their way were dropped


def test_rounded_exposures_are_logged(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(VirtualUvc, "step", 100)
    with UvcCamera(replace(SENSOR, exposures=(0.012, 0.05))) as camera:
        assert camera.sensor.exposures == (0.01, 0.05)
    assert "uses 0.01 s for an exposure of 0.012 s" in caplog.text
    with pytest.raises(InputError, match=r"after rounding sensor\.exposures"):
        UvcCamera(replace(SENSOR, exposures=(0.01, 0.012)))


def test_a_device_that_ends_is_opened_again(tmp_path: Path) -> None:
    device = sequence(tmp_path, frames=3)
    with Webcam(SENSOR, device=device, backend="images", **QUICK) as camera:
        for _ in range(3):
            assert (camera.expose()[0] == PICTURE).all()
        assert camera.statistics == {"frames": 3, "failed": 2, "timed_out": 0, "reconnected": 2}


@pytest.mark.parametrize(
    ("changes", "kind", "expected"),
    [
        ({"device": "/nowhere/%04d.png"}, CaptureError, r"can't be opened.*group video"),
        ({"shape": (48, 64)}, CaptureError, r"24 x 30 pixels; camera\.options\.shape is 48 x 64"),
        ({"sensor": replace(SENSOR, exposures=(0.01, 0.1))}, InputError, "one time, not 2"),
        ({"sensor": CameraModel()}, InputError, "8 bits and no mosaic"),
    ],
)
def test_device_errors_are_explained(
    tmp_path: Path, changes: dict[str, Any], kind: type[Exception], expected: str
) -> None:
    settings = {"device": sequence(tmp_path), "backend": "images", **QUICK, **changes}
    with pytest.raises(kind, match=expected):
        Webcam(settings.pop("sensor", SENSOR), **settings)
