"""A rig's settings: defaults, generated files, and what a mistake says."""

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import rfpipe.config
from rfpipe.config import RigConfig, load_rig_config, parse_rig_config
from rfpipe.config.base import MethodSettings, Settings
from rfpipe.config.drivers import FreeOptions
from rfpipe.config.files import bench_yaml, rig_json_schema, rig_yaml
from rfpipe.errors import ConfigError
from rfpipe.rigs.cameras.genicam import GenicamOptions
from rfpipe.rigs.window import WindowOptions
from rfpipe_devices.aravis import AravisOptions
from rfpipe_devices.gphoto import PhotoOptions
from rfpipe_devices.webcam import WebcamOptions

FOLDER = Path(__file__).parents[2] / "config"
PLANE = {"kind": "plane", "surfaces": ["white"], "channels": 1}


def message(data: object) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_rig_config(data, "rig.yaml")
    return str(caught.value)


def test_generated_files_are_in_step_with_the_model() -> None:
    assert (FOLDER / "rig.yaml").read_text(encoding="utf-8") == rig_yaml()
    assert (FOLDER / "bench.yaml").read_text(encoding="utf-8") == bench_yaml()
    stored = json.loads((FOLDER / "rig.schema.json").read_text(encoding="utf-8"))
    assert stored == rig_json_schema()


def test_the_default_file_holds_the_defaults() -> None:
    assert load_rig_config(FOLDER / "rig.yaml") == RigConfig() == parse_rig_config({}, "rig.yaml")


def test_every_setting_has_a_description() -> None:
    names = ["RigConfig", *RigConfig.model_json_schema()["$defs"]]
    own = {"FreeOptions": FreeOptions, "Settings": Settings, "MethodSettings": MethodSettings}
    models: list[type[BaseModel]] = [
        own.get(name) or getattr(rfpipe.config, name) for name in names
    ]
    models += [WindowOptions, GenicamOptions, AravisOptions, PhotoOptions, WebcamOptions]
    bare = [
        f"{model.__name__}.{name}"
        for model in models
        for name, field in model.model_fields.items()
        if not field.description
    ]
    assert len(models) > 5
    assert bare == []


@pytest.mark.parametrize(
    ("name", "bits", "bayer"),
    [
        ("Mono8", 8, None),
        ("Mono16", 16, None),
        ("BayerRG12", 12, "RGGB"),
        ("BayerGR10", 10, "GRBG"),
        ("BayerGB8", 8, "GBRG"),
        ("BayerBG16", 16, "BGGR"),
    ],
)
def test_pixel_formats_say_bits_and_mosaic(name: str, bits: int, bayer: str | None) -> None:
    sensor = {"bits": bits, "bayer": bayer}
    config = parse_rig_config(
        {"camera": {"options": {"pixel_format": name}}, "sensor": sensor}, "rig.yaml"
    )
    assert (config.camera.options.bits, config.camera.options.bayer) == (bits, bayer)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        ({"projector": {"options": {"display": "HDMI-1"}}},
         "projector.options.display is 'HDMI-1'"),
        ({"projector": {"options": {"settle_second": 1}}}, "did you mean settle_seconds?"),
        ({"camera": {"options": {"pixel_format": "Mono12p"}}},
         "camera.options.pixel_format is 'Mono12p'"),
        ({"camera": {"options": {"pixel_format": "BayerRG8"}}},
         "sensor.bits should be 8 with camera.options.pixel_format BayerRG8, not 12"),
        ({"sensor": None}, "sensor should be set with kind devices"),
        ({"scene": PLANE}, "scene should be null with kind devices"),
        ({"kind": "simulated", "scene": PLANE, "bench": {}}, "bench should be null"),
        ({"bench": {"scene": {**PLANE, "channels": 3}}},
         "bench.scene.channels should be 1 with camera.options.pixel_format Mono12, not 3"),
        ({"bench": {}, "projector": {"options": {"display": ":0"}}},
         "projector.options.display should be null"),
        ({"bench": {}, "camera": {"options": {"shape": [8, 8]}}},
         "camera.options.shape should be null"),
        ({"bench": {"camera_corners": [[[0, 0], [9, 0], [9, 9], [0, 9]]] * 2}},
         "camera_corners should have four corners for each of the scene's 1 views, not for 2"),
    ],
)  # fmt: skip
def test_mistakes_are_explained(data: dict[str, Any], expected: str) -> None:
    text = message(data)
    assert text.startswith("rig.yaml: ")
    assert expected in text


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml: can't be read"):
        load_rig_config(tmp_path / "absent.yaml")
