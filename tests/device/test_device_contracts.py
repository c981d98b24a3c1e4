"""The contracts of projectors, cameras and rigs on simulated devices, and on faulty ones."""

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from tests.rigs.simulated_devices import SimulatedCamera, SimulatedProjector

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.photometry.resampling import Resampling
from rfpipe.rigs import DeviceRig, ProjectorLayout
from rfpipe.testing import CameraContract, ProjectorContract, RigContract

SENSOR = CameraModel(exposures=(1 / 64, 1 / 16))
RAYS, PROJECTOR, CAMERA = (4, 5), (18, 22), (9, 11)


def devices() -> tuple[SimulatedProjector, SimulatedCamera]:
    """The camera sees every other row and column of the projector's picture, pixel by pixel."""
    projector = SimulatedProjector(PROJECTOR)
    camera = SimulatedCamera(lambda: projector.light[::2, ::2, None] / 2, CAMERA, 1, SENSOR)
    return projector, camera


class TestResampledRig(RigContract):
    repeatable = False

    def make_rig(self) -> DeviceRig:
        return DeviceRig(*devices(), ProjectorLayout.grid(PROJECTOR, RAYS), resampling())


def resampling() -> Resampling:
    """Each ray is the camera pixel in its middle."""
    middle = np.arange(99).reshape(CAMERA)[1::2, 1::2].ravel()
    return Resampling(RAYS, CAMERA, csr_array(np.eye(99, dtype=np.float32)[middle]))


def test_devices_that_do_not_fit_are_refused() -> None:
    projector, camera = devices()
    with pytest.raises(InputError, match=r"projector has .* calibration was made with \(9, 22\)"):
        DeviceRig(projector, camera, ProjectorLayout.grid((9, 22), RAYS))
    camera.shape = (5, 5)
    with pytest.raises(InputError, match=r"camera has .* calibration was made with \(9, 11\)"):
        DeviceRig(projector, camera, None, resampling())


@pytest.mark.parametrize(("count", "dtype"), [(1, "uint16"), (2, "uint8")])
def test_a_wrong_bracket_names_the_pattern(count: int, dtype: str) -> None:
    projector, camera = devices()
    camera.expose = lambda: np.zeros((count, *CAMERA, 1), dtype)  # type: ignore[method-assign]
    what = rf"pattern \(2, 7\): the camera returned {dtype} frames of shape \({count}, 9, 11, 1\)"
    with DeviceRig(projector, camera) as rig, pytest.raises(CaptureError, match=what):
        rig.capture(np.ones((1, *PROJECTOR), np.float32), [(2, 7)])


class BrokenProjector(SimulatedProjector):
    def __init__(self, fault: str) -> None:
        super().__init__(PROJECTOR)
        self._fault, self._shown = fault, 0
        self._next = self.light

    def show(self, picture: np.ndarray) -> None:
        self._shown += 1
        if self._fault == "clips":
            picture = np.nan_to_num(picture).clip(0, 1)
        if self._fault == "one pixel off":
            picture = np.roll(picture, 1, axis=1)
        if self._fault == "never closes":
            self._closed = False
        super().show(picture)
        if self._fault == "keeps a view":
            self.light = picture
        if self._fault == "one picture late":
            self.light, self._next = self._next, self.light

    def describe(self) -> dict[str, Any]:
        return super().describe() | ({"shown": self._shown} if self._fault == "counts" else {})


class BrokenCamera(SimulatedCamera):
    def __init__(self, fault: str) -> None:
        self.is_lit = True
        super().__init__(lambda: np.full((*CAMERA, 1), 0.5 * self.is_lit), CAMERA, 1, SENSOR)
        self._fault, self._buffer = fault, np.zeros((2, *CAMERA, 1), np.uint16)

    def set_light(self, is_on: bool) -> bool:
        self.is_lit = is_on and self._fault != "in the dark"
        return self._fault != "in the dark"

    def expose(self) -> np.ndarray:
        frames = super().expose()
        if self._fault == "late by a frame":
            frames = frames // self._brackets
        if self._fault in ("reuses its buffer", "one picture late"):
            before = self._buffer.copy()
            self._buffer[...] = frames
            frames = self._buffer if self._fault == "reuses its buffer" else before
        return frames[::-1] if self._fault == "turns exposures round" else frames

    def describe(self) -> dict[str, Any]:
        return super().describe() | ({"taken": self._brackets} if self._fault == "counts" else {})


@pytest.mark.parametrize(
    ("device", "fault", "test"),
    [
        (BrokenProjector, "clips", "rejects_what_cannot_be_shown"),
        (BrokenProjector, "one pixel off", "shows_pixel_by_pixel"),
        (BrokenProjector, "one picture late", "shows_pixel_by_pixel"),
        (BrokenProjector, "keeps a view", "accepts_any_memory_layout_and_keeps_no_reference"),
        (BrokenProjector, "never closes", "describes_itself_and_closes"),
        (BrokenProjector, "counts", "describes_itself_and_closes"),
        (BrokenCamera, "turns exposures round", "exposures"),
        (BrokenCamera, "late by a frame", "exposures"),
        (BrokenCamera, "in the dark", "exposures"),
        (BrokenCamera, "one picture late", "brackets_follow_the_light"),
        (BrokenCamera, "reuses its buffer", "brackets"),
        (BrokenCamera, "counts", "describes_itself_and_closes"),
    ],
)
def test_the_contract_detects_violations(device: Any, fault: str, test: str) -> None:
    suite: Any = ProjectorContract() if device is BrokenProjector else CameraContract()
    suite.make_projector = suite.make_camera = lambda: device("none")
    suite.read_back = lambda projector: projector.light
    suite.set_light = BrokenCamera.set_light
    getattr(suite, f"test_{test}")()
    suite.make_projector = suite.make_camera = lambda: device(fault)
    with pytest.raises(AssertionError):
        getattr(suite, f"test_{test}")()
