"""A rig's settings: defaults, generated files, and what a mistake says."""

from pathlib import Path
from typing import Any

import pytest

from rfpipe.config import RigConfig, load_rig_config, parse_rig_config
from rfpipe.errors import ConfigError

FOLDER = Path(__file__).parents[2] / "config"
PLANE = {"kind": "plane", "surfaces": ["white"], "channels": 1}


def test_the_default_file_holds_the_defaults() -> None:
    assert load_rig_config(FOLDER / "rig.yaml") == RigConfig() == parse_rig_config({}, "rig.yaml")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({"projector": {"options": {"display": "HDMI-1"}}},
         "projector.options.display is 'HDMI-1'"),
        ({"projector": {"options": {"settle_second": 1}}}, "did you mean settle_seconds?"),
        ({"bench": {"camera": {"bits": 8}}}, "bench.camera.bits and bench.camera.bayer should be"),
        ({"calibrate": {"period_pixels": 10}}, "period_pixels is 10; it should be a multiple of 4"),
        ({"calibrate": {"views": [1, 2], "corners": [[[0, 0], [1, 0], [1, 1], [0, 1]]]}},
         "corners should have four corners for each of 2 views, not for 1"),
        ({"sensor": None}, "sensor should be set with kind devices"),
        ({"scene": PLANE}, "scene should be null with kind devices"),
        ({"kind": "simulated", "scene": PLANE, "bench": {}}, "bench should be null"),
        ({"bench": {"scene": {**PLANE, "channels": 3}}},
         "bench.scene.channels should be 1 with sensor.bayer null, not 3"),
        ({"bench": {"scene": {**PLANE, "projector": {"position": [1, 0, 0]}}}},
         "scene should be a coaxial one"),
        ({"bench": {"camera_corners": [[[0, 0], [9, 0], [9, 9], [0, 9]]] * 2}},
         "camera_corners should have four corners for each of 1 views, not for 2"),
    ],
)  # fmt: skip
def test_mistakes_are_explained(data: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_rig_config(data, "rig.yaml")
    assert str(caught.value).startswith("rig.yaml: ")
    assert expected in str(caught.value)
