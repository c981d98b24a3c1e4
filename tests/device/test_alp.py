"""ViALUX' ALP projectors, by ALP4lib on an emulation of ViALUX' library."""

import ctypes
from typing import Any

import numpy as np
import pytest
from tests.device.test_dlpc900 import MISSED, SHAPE, check_sequences
from tests.emulators.alp import AlpLibrary

from rfpipe.devices.alp import AlpProjector
from rfpipe.errors import CaptureError, InputError
from rfpipe.testing import ProjectorContract

pytestmark = pytest.mark.needs("alp")


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> AlpLibrary:
    library = AlpLibrary(SHAPE)
    monkeypatch.setattr(ctypes, "CDLL", lambda path: library)
    return library


def projector(**options: Any) -> AlpProjector:
    return AlpProjector(**{"settle_seconds": 0, "folder": "here", **options})


class TestAlp(ProjectorContract):
    @pytest.fixture(autouse=True)
    def _library(self, library: AlpLibrary) -> None:
        self.library = library

    def make_projector(self) -> AlpProjector:
        return projector()

    def read_back(self, shown: Any) -> Any:
        del shown
        return self.library.lit


def test_sequences_are_displayed_in_any_order(library: AlpLibrary) -> None:
    random = np.random.default_rng(0)
    pictures = (random.random((13, *SHAPE)) < 0.5).astype(np.float32)
    exposures: list[np.ndarray] = []
    library.triggered = lambda microseconds: exposures.append(library.lit * microseconds)
    with projector() as shown:
        assert (shown.sequence_pictures, shown.sequence_levels) == (60, 2)
        shown.load(pictures)
        order = random.integers(0, 13, 21).tolist()
        shown.play(order, 150e-6)
        shown.play(order[:2], 200e-6)
        assert library.loads == 13
        shown.load(pictures[:3])
        assert [len(sequence.pictures) for sequence in library.sequences.values()] == [3]
    np.testing.assert_array_equal(np.stack(exposures[:21]), 150 * pictures[order])
    np.testing.assert_array_equal(np.stack(exposures[21:]), 200 * pictures[order[:2]])


@pytest.mark.parametrize("missed", MISSED)
def test_a_rig_captures_binary_patterns_in_sequences(library: AlpLibrary, missed: set[int]) -> None:
    check_sequences(projector(), library, missed)


def test_errors_are_explained(library: AlpLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    with projector() as shown:
        with pytest.raises(CaptureError, match="no pictures are loaded"):
            shown.play([0], 1e-3)
        with pytest.raises(InputError, match=r"picture 1 is 0\.5 at projector pixel \(0, 0\)"):
            shown.load(np.stack([np.zeros(SHAPE, np.float32), np.full(SHAPE, np.float32(0.5))]))
        with pytest.raises(InputError, match="holds at most 60 pictures"):
            shown.load(np.zeros((61, *SHAPE), np.float32))
        shown.load(np.zeros((2, *SHAPE), np.float32))
        with pytest.raises(CaptureError, match=r"for 44 us to 10\.0 s, not for 2e-05 s"):
            shown.play([0], 20e-6)
        library.fault = 1012
        with pytest.raises(CaptureError, match=r"has been removed\. Check its power and cable"):
            shown.play([0], 1e-3)
    with pytest.raises(CaptureError, match="has been removed"):
        projector()

    def missing(path: str) -> None:
        raise OSError(f"{path}: no such file")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    with pytest.raises(CaptureError, match=r"ALP library 5\.1 can't be loaded: here/.*no such"):
        projector(version="5.1")
