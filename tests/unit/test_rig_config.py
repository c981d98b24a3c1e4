"""A rig's settings: defaults, generated files, and messages about mistakes."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rfpipe import plugins
from rfpipe.config import (
    BenchConfig,
    CalibrationConfig,
    RigConfig,
    load_config,
    load_rig_config,
    parse_rig_config,
)
from rfpipe.config.camera import CameraConfig
from rfpipe.config.drivers import CameraDriver, ProjectorDriver
from rfpipe.errors import ConfigError

FOLDER = Path(__file__).parents[2] / "config"
SOURCES = FOLDER.parent / "src"
PLANE = {"kind": "plane", "surfaces": ["white"], "channels": 1}


NAMED = re.compile(r"\b(?:projector|camera|sensor|calibrate|bench|rays)(?:\.[a-z_]+)+")


def texts_of(file: Path) -> Iterator[str]:
    """Yield the texts of a source, docstrings left out, f-strings without their values."""
    tree = ast.parse(file.read_text())
    documented = ast.Module | ast.ClassDef | ast.FunctionDef
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        if is_text and id(node) not in docstrings:
            yield node.value


def settings_of_devices() -> set[str]:
    """Return the dotted names of a rig's settings, with the options of all drivers."""
    names = {f"bench.{name}" for name in BenchConfig.model_fields}
    names |= {f"calibrate.{name}" for name in CalibrationConfig.model_fields}
    names |= {
        f"{group}.{name}"
        for group in ("sensor", "bench.camera")
        for name in CameraConfig.model_fields
    }
    for section, model in (("projector", ProjectorDriver), ("camera", CameraDriver)):
        names |= {f"{section}.driver", f"{section}.options"}
        for driver in plugins.names(model.group):
            options = model.options_model(driver).model_fields
            names |= {f"{section}.options.{name}" for name in options}
    return names


def test_messages_of_rigs_name_existing_settings() -> None:
    known, wrong, count = settings_of_devices(), [], 0
    for folder in ("rfpipe/devices", "rfpipe/calibration", "rfpipe/server"):
        for file in sorted((SOURCES / folder).rglob("*.py")):
            names = [name for text in texts_of(file) for name in NAMED.findall(text)]
            wrong += [f"{file.name}: {name}" for name in names if name not in known]
            count += len(names)
    assert not wrong
    assert count > 20


def test_a_rig_s_file_is_distinguished_from_a_run_s() -> None:
    with pytest.raises(ConfigError, match=r"settings of a rig \(.*rays.*\), for rfpipe aim, cal"):
        load_config(FOLDER / "rig.yaml")


def test_the_default_file_contains_the_defaults() -> None:
    assert load_rig_config(FOLDER / "rig.yaml") == RigConfig() == parse_rig_config({}, "rig.yaml")


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({"projector": {"options": {"display": "HDMI-1"}}},
         "projector.options.display is 'HDMI-1'"),
        ({"projector": {"options": {"settle_second": 1}}}, "did you mean settle_seconds?"),
        ({"projector": {"driver": "windw", "options": {"display": ":0"}}},
         "projector.driver: 'windw' is unknown; did you mean window? Expected one of alp, "),
        ({"camera": {"driver": "arvis", "options": {"serial": "1"}}}, "did you mean aravis?"),
        ({"scenes": {}, "methods": {}, "seed": 1},
         "the settings of a run (scenes, methods), not those of a rig. Give the rig's file: one"),
        ({"scenes": {}, "methods": {}, "rig_file": "mine.yaml"}, "this run's is mine.yaml"),
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
         "scene should be coaxial"),
        ({"bench": {"camera_corners": [[[0, 0], [9, 0], [9, 9], [0, 9]]] * 2}},
         "camera_corners should have four corners for each of 1 views, not for 2"),
    ],
)  # fmt: skip
def test_mistakes_are_explained(data: dict[str, Any], expected: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_rig_config(data, "rig.yaml")
    assert str(caught.value).startswith("rig.yaml: ")
    assert expected in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
