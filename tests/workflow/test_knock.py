"""The bench is knocked in the middle of an acquisition (`bench.knock`), and that is noticed.

Its camera's pixels are its rays, so that it is a coaxial rig without a calibration.
"""

from __future__ import annotations

import re
from typing import Any

import pytest

import rfpipe
from rfpipe.config import parse_rig_config
from rfpipe.errors import CaptureError
from rfpipe.rigs.build import rig_from_config

pytestmark = pytest.mark.slow

HEIGHT, WIDTH = SHAPE = (12, 16)
PIXELS = 8  # of the projector, a ray
SCENE = {"kind": "wedge", "surfaces": ["white", "texture"], "shape": list(SHAPE), "channels": 1}
EXPOSURES = [1 / 64, 1 / 8]
BLACK, FLOODLIT = 4, 8
WITHIN = 10


def settings(brackets: int | None) -> dict[str, Any]:
    """Return the settings of a bench that is knocked by half a ray after so many brackets."""
    knock = None if brackets is None else [brackets * len(EXPOSURES), 0, PIXELS // 2]
    return {
        "kind": "devices",
        "rays": list(SHAPE),
        "projector": {"options": {"settle_seconds": 0}},
        "sensor": {"exposures": EXPOSURES},
        "bench": {
            "scene": SCENE,
            "display_shape": [PIXELS * HEIGHT, PIXELS * WIDTH],
            "camera_shape": list(SHAPE),
            "camera_corners": [[[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]]],
            "projector_gamma": 1.0,
            "knock": knock,
        },
    }


class Acquired:
    """What came of an acquisition that reciprocity may end, and the patterns shown for it."""

    def __init__(self, method: str, knocked_after: int | None) -> None:
        before = None if knocked_after is None else BLACK + FLOODLIT + knocked_after
        self.patterns: list[tuple[int, ...]] = []
        self.ended: str | None = None
        with rig_from_config(parse_rig_config(settings(before), "rig.yaml")) as rig:  # type: ignore[attr-defined]
            capture = rig.capture

            def recorded(patterns: Any, keys: Any) -> Any:
                self.patterns += [tuple(key) for key in keys if key[0] < 1000]
                return capture(patterns, keys)

            rig.capture = recorded
            try:
                rfpipe.acquire(
                    rig, method, watch="refuse", black_frames=BLACK, floodlit_frames=FLOODLIT,
                    symmetry_frames=0, progress=False,
                )  # fmt: skip
            except CaptureError as error:
                self.ended = str(error)
            self.retaken = rig.statistics["brackets"]["doubted"]


@pytest.mark.parametrize("at", [5, 12])
@pytest.mark.parametrize("method", ["symmetric", "near_far"])
def test_reciprocity_notices_it_within_ten_patterns(method: str, at: int) -> None:
    acquired = Acquired(method, at)
    assert acquired.retaken == 0  # or the knock came earlier
    found = re.search(r"level (\d+), pattern (\d+): light doesn't go", acquired.ended or "")
    assert found is not None
    noticed = acquired.patterns.index((int(found[1]), int(found[2]))) + 1
    assert at < noticed <= at + WITHIN


@pytest.mark.parametrize("method", ["symmetric", "near_far"])
def test_a_bench_that_stands_still_is_left_alone(method: str) -> None:
    assert Acquired(method, None).ended is None
