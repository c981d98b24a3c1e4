"""The contract of rigs on simulated rigs, and on rigs that violate it."""

from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest
from tests.server.harness import transport

from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig, Rig
from rfpipe.testing import RigContract

CAMERA = CameraModel()

SERIAL = count()


class TestRigWithMosaicAndOptics(RigContract):
    def make_rig(self) -> Rig:
        camera = replace(CAMERA, bayer="GRBG", psf_sigma=0.7, vignetting=0.3, flare=0.05)
        return OperatorRig(transport(20, 21), (4, 5), (3, 7), noise=camera)


class TestRigOfViews(RigContract):
    def make_rig(self) -> Rig:
        return OperatorRig(transport(24, 24), (2, 3, 4), (2, 3, 4), noise=CAMERA)


class TestRigOfOneRay(RigContract):
    def make_rig(self) -> Rig:
        return OperatorRig(np.ones((1, 1)), (1, 1), (1, 1), noise=CAMERA)


class Broken(OperatorRig):
    """A rig with one fault."""

    def __init__(self, fault: str) -> None:
        light = 3 if fault == "three times the light" else 1
        super().__init__(np.full((30, 30), light / 40), (5, 6), (5, 6), noise=CAMERA)
        self._fault = fault
        self._captured = 0
        self._shown = np.zeros((1, 5, 6), np.float32)

    def capture(self, patterns: np.ndarray, keys: Any) -> np.ndarray:
        self._captured += 1
        if self._fault == "clips patterns":
            patterns = np.nan_to_num(patterns).clip(0, 1)
        if self._fault == "forgets its key":
            keys = [(self._captured, index) for index in range(len(keys))]
        if self._fault == "one noise for all":
            keys = [(0, 0)] * len(keys)
        if self._fault == "ambient light":
            patterns = np.maximum(patterns, 0.1 * (patterns.sum() > 0)).astype(np.float32)
        if self._fault == "one picture late" and len(patterns):
            shown, self._shown = self._shown, patterns[-1:]
            patterns = np.concatenate([shown, patterns[:-1]])
        if self._fault in ("in the dark", "one column is dark"):
            patterns = patterns * np.float32(np.arange(6) < 5 * (self._fault != "in the dark"))
        frames = super().capture(patterns, keys)
        if self._fault == "flickering black level":
            frames[[key[1] == 7 for key in keys]] += np.uint16(40)
        return frames[:, :2] if self._fault == "loses a frame" else frames

    def describe(self) -> dict[str, Any]:
        made = {"made": next(SERIAL)} if self._fault == "unstable description" else {}
        used = {"captured": self._captured} if self._fault == "describes its use" else {}
        return super().describe() | made | used


@pytest.mark.parametrize(
    ("fault", "test"),
    [
        ("clips patterns", "rejects_what_cannot_be_shown"),
        ("forgets its key", "same_bytes_however_captured"),
        ("one noise for all", "same_bytes_however_captured"),
        ("ambient light", "light_adds_up"),
        ("flickering black level", "light_adds_up"),
        ("loses a frame", "frames"),
        ("one picture late", "light_adds_up"),
        ("in the dark", "light_adds_up"),
        ("one column is dark", "light_adds_up"),
        ("three times the light", "light_adds_up"),
        ("unstable description", "describes_itself"),
        ("describes its use", "describes_itself"),
    ],
)
def test_the_contract_detects_violations(fault: str, test: str) -> None:
    suite: Any = RigContract()
    suite.make_rig = lambda: Broken("none")
    getattr(suite, f"test_{test}")()
    suite.make_rig = lambda: Broken(fault)
    with pytest.raises(AssertionError):
        getattr(suite, f"test_{test}")()
