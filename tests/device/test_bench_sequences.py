"""Hardware sequences on the bench with a triggered, emulated camera."""

import time

import numpy as np
import pytest
from tests.device.test_bench import RAYS, bench

from rfpipe.errors import CaptureError

COUNT = 9


def shown() -> tuple[np.ndarray, list[tuple[int, int]]]:
    patterns = (np.random.default_rng(0).random((COUNT, *RAYS)) < 0.5).astype(np.float32)
    return patterns, [(1, index) for index in range(COUNT)]


def test_a_sequence_gives_the_frames_of_single_pictures() -> None:
    camera = {"options": {"sequence_line": "Software", "timeout_seconds": 0.5}}
    with bench(camera=camera) as rig:
        one_by_one = rig.capture(*shown()).astype(float)
        frames = rig.show_sequence(*shown()).astype(float)
        assert rig.statistics["sequences"] == {"played": 2, "lost": 0, "one_by_one": 0}
    assert frames.shape == one_by_one.shape
    step = np.abs(one_by_one[1:] - one_by_one[:-1]).mean()
    assert np.abs(frames - one_by_one).mean() < 0.05 * step


def test_without_a_line_there_are_no_sequences() -> None:
    with bench() as plain:
        assert plain.sequence_patterns == 0
        assert plain.show_sequence(*shown()).shape[0] == COUNT  # one by one


def test_a_silent_trigger_input_ends_the_sequence_in_time() -> None:
    camera = {"options": {"sequence_line": "Line1", "timeout_seconds": 0.2}}
    with bench(camera=camera) as rig:
        assert rig.sequence_patterns == 199
        camera = rig.camera
        camera.arm(1 / 64, 5)
        assert camera._handle.TriggerSource.Value == "Line1"
        assert camera._handle.TriggerActivation.Value == "RisingEdge"
        began = time.monotonic()
        assert camera.collect().shape == (0, *camera.shape, 1)
        assert time.monotonic() - began < 20
        assert camera._handle.TriggerSource.Value == "Software"
        assert camera.expose().shape[0] == 2
        with pytest.raises(CaptureError, match="isn't armed"):
            camera.collect()
