"""The public suites of projectors, cameras and rigs on simulated devices, and on broken ones."""

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from tests.simulated_devices import SimulatedCamera, SimulatedProjector

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.photometry.resampling import Resampling
from rfpipe.rigs import DeviceRig, ProjectorLayout
from rfpipe.testing import CameraContract, ProjectorContract, RigContract

SENSOR = CameraModel(exposures=(1 / 64, 1 / 16))
RAYS, PROJECTOR, CAMERA = (4, 5), (18, 22), (11, 14)


def devices() -> tuple[SimulatedProjector, SimulatedCamera]:
    """The camera sees the middle of the projector's picture, pixel by pixel."""
    projector = SimulatedProjector(PROJECTOR)
    camera = SimulatedCamera(lambda: projector.light[2:13, 2:16, None] / 2, CAMERA, 1, SENSOR)
    return projector, camera


class TestResampledRig(RigContract):
    repeatable = False

    def make_rig(self) -> DeviceRig:
        return DeviceRig(*devices(), ProjectorLayout.grid(PROJECTOR, RAYS), resampling())


def resampling() -> Resampling:
    """Each ray is a camera pixel."""
    return Resampling(RAYS, CAMERA, csr_array(np.eye(20, 154, dtype=np.float32)))


def test_devices_that_do_not_fit_are_refused() -> None:
    projector, camera = devices()
    with pytest.raises(InputError, match=r"calibration is of a projector of \(9, 22\) pixels"):
        DeviceRig(projector, camera, ProjectorLayout.grid((9, 22), RAYS))
    camera.shape = (5, 5)
    with pytest.raises(InputError, match=r"calibration is of a camera of \(11, 14\) pixels"):
        DeviceRig(projector, camera, None, resampling())


@pytest.mark.parametrize(("count", "dtype"), [(1, "uint16"), (2, "uint8")])
def test_a_wrong_bracket_names_the_pattern(count: int, dtype: str) -> None:
    projector, camera = devices()
    camera.expose = lambda: np.zeros((count, *CAMERA, 1), dtype)  # type: ignore[method-assign]
    what = rf"pattern \(2, 7\): the camera returned {dtype} frames of shape \({count}, 11, 14, 1\)"
    with DeviceRig(projector, camera) as rig, pytest.raises(CaptureError, match=what):
        rig.capture(np.ones((1, *PROJECTOR), np.float32), [(2, 7)])


class BrokenProjector(SimulatedProjector):
    def __init__(self, fault: str) -> None:
        super().__init__(PROJECTOR)
        self._fault = fault

    def show(self, picture: np.ndarray) -> None:
        if self._fault == "clips":
            picture = np.nan_to_num(picture).clip(0, 1)
        if self._fault == "one pixel off":
            picture = np.roll(picture, 1, axis=1)
        if self._fault == "never closes":
            self._closed = False
        super().show(picture)
        if self._fault == "keeps a view":
            self.light = picture


class BrokenCamera(SimulatedCamera):
    def __init__(self, fault: str) -> None:
        super().__init__(lambda: np.full((*CAMERA, 1), 0.5), CAMERA, 1, SENSOR)
        self._fault, self._buffer = fault, np.empty((2, *CAMERA, 1), np.uint16)

    def expose(self) -> np.ndarray:
        frames = super().expose()
        if self._fault == "late by a frame":
            frames = frames // self._brackets
        if self._fault == "reuses its buffer":
            self._buffer[...] = frames
            frames = self._buffer
        return frames[::-1] if self._fault == "turns exposures round" else frames


@pytest.mark.parametrize(
    ("device", "fault", "test"),
    [
        (BrokenProjector, "clips", "rejects_what_cannot_be_shown"),
        (BrokenProjector, "one pixel off", "shows_pixel_by_pixel"),
        (BrokenProjector, "keeps a view", "takes_any_memory_layout_and_keeps_no_hold_of_it"),
        (BrokenProjector, "never closes", "describes_itself_and_closes"),
        (BrokenCamera, "turns exposures round", "exposures"),
        (BrokenCamera, "late by a frame", "exposures"),
        (BrokenCamera, "reuses its buffer", "brackets"),
    ],
)
def test_the_contract_finds_what_is_wrong(device: Any, fault: str, test: str) -> None:
    suite: Any = ProjectorContract() if device is BrokenProjector else CameraContract()
    suite.make_projector = suite.make_camera = lambda: device(fault)
    suite.read_back = lambda projector: projector.light
    with pytest.raises(AssertionError):
        getattr(suite, f"test_{test}")()
