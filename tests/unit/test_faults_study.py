"""What bad input and failing rigs lead to; stopped runs are in tests/workflow/test_figures.py."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tests.helpers import settings_of_a_plane

import rfpipe
from rfpipe.errors import CaptureError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes.reference import reference_scene
from rfpipe.stages.evaluating.studies import faults


@pytest.fixture(scope="module")
def of_frames() -> dict[str, dict[str, Any]]:
    return {row["case"]: row for row in faults._frames(settings_of_a_plane())}


@pytest.mark.parametrize(
    ("case", "said"),
    [
        ("NaN in a frame", "holds nan"),
        ("infinite frame", "holds inf"),
        ("negative frame", "holds -1.0"),
        ("frame of another size", "expected (4, 16, 16, 1)"),
        ("saturated at every exposure", "saturated even at the shortest exposure"),
        ("floodlit image all black", "all black"),
        ("black level above the signal", "black level is above the signal"),
    ],
)
def test_frames_that_cannot_be_pictures_are_refused(
    of_frames: dict[str, dict[str, Any]], case: str, said: str
) -> None:
    row = of_frames[case]
    assert row["happened"].startswith("refused")
    assert said in row["happened"]
    assert row["patterns"] is None


def test_a_late_rig_and_one_with_bad_pixels_are_acquired(
    of_frames: dict[str, dict[str, Any]],
) -> None:
    late, spoilt = of_frames["rig answers late"], of_frames["a dead and a hot pixel"]
    assert late["happened"] == "acquired"
    assert late["relight_error"] < 0.02
    assert spoilt["happened"].startswith("2 camera pixels left out")
    assert spoilt["patterns"] > 0


def test_bad_settings_and_a_rig_without_answer_are_refused() -> None:
    unknown, unit = (row["happened"] for row in faults._settings())
    assert "exposure is unknown" in unknown
    assert "'16 ms'" in unit
    (silent,) = faults._rigs()
    assert "no answer" in silent["happened"]


def test_a_method_that_hands_over_says_so() -> None:
    scene = faults.hard_cases()["mirror"]()
    row = faults._acquired("mirror", scene, "near_far", SimulatedRig(scene), "exact")
    assert row["happened"] == "handed over to symmetric photography"
    assert row["relight_error"] < 1e-6


def test_an_acquisition_in_process_refuses_frames_of_another_size() -> None:
    class Cropped(SimulatedRig):
        def capture(self, patterns: Any, keys: Any) -> Any:
            return super().capture(patterns, keys)[:, :, 1:]

    rig = Cropped(reference_scene("IV", (4, 5), channels=1))
    with pytest.raises(CaptureError, match=r"shape \(1, 3, 5, 1\); expected \(1, 4, 5, 1\)"):
        rfpipe.acquire(rig, progress=False)
    assert np.prod(rig.camera_shape) == 20
