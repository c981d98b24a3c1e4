"""Settings: defaults, generated files, and messages about mistakes."""

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from rfpipe.config import Config, RigConfig, load_camera, load_config, parse_config
from rfpipe.config.files import is_rig
from rfpipe.config.schema import generated, schema_of
from rfpipe.errors import ConfigError
from rfpipe.scenes import REFERENCE_SCENES

FOLDER = Path(__file__).parents[2] / "config"
RUN = load_config(FOLDER / "config.yaml")
BARE = {"scenes": {"one": {"kind": "plane", "surfaces": ["white"]}}}
ROOM = {"kind": "room", "surfaces": ["texture", "white", "white"]}
BARE_TEXT = f"{json.dumps(BARE)[1:-1]}\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def message(data: object) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(data, "mine.yaml")
    return str(caught.value)


@cache
def validator(model: type[Config | RigConfig]) -> jsonschema.Draft202012Validator:
    """Return a validator of settings by the schema of their model."""
    jsonschema.Draft202012Validator.check_schema(schema := schema_of(model))
    return jsonschema.Draft202012Validator(schema)


def test_generated_files_match_the_models() -> None:
    for name, text in generated().items():
        assert (FOLDER / name).read_text(encoding="utf-8") == text, name


def test_all_settings_are_listed_at_their_defaults() -> None:
    assert load_config(FOLDER / "all.yaml") == parse_config(
        {"scenes": {"one": {"kind": "plane"}}}, ""
    )


def test_the_default_file_shows_the_settings_to_decide() -> None:
    text = (FOLDER / "config.yaml").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 80
    assert [*validator(Config).iter_errors(yaml.safe_load(text))] == []
    shown = RUN.scenes
    assert RUN.methods_of(next(iter(shown))).keys() == {"auto"}
    assert next(iter(shown.values())).shape >= (96, 108)
    # numbers shown in the file equal the defaults
    assert RUN.result_settings() == {**parse_config(BARE, "bare").result_settings(), **{
        name: RUN.result_settings()[name] for name in ("scenes", "methods", "report")
    }}  # fmt: skip


@pytest.mark.parametrize("path", [*FOLDER.glob("*.yaml")], ids=lambda path: path.stem)
def test_files_conform_to_the_schema(path: Path) -> None:
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert [*validator(RigConfig if is_rig(data) else Config).iter_errors(data)] == []


def test_thesis_file_has_the_scenes_of_fig_2_1_and_a_light_field() -> None:
    thesis = load_config(FOLDER / "thesis.yaml")
    for name, (kind, surfaces) in zip(
        ("planes_i", "planes_ii", "planes_iii", "planes_iv"), REFERENCE_SCENES.values(), strict=True
    ):
        for file in (thesis, load_config(FOLDER / "figures.yaml")):
            assert (file.scenes[name].kind, file.scenes[name].surfaces) == (kind, surfaces)
        assert thesis.scenes[name].ray_shape == (310, 350)
    methods = {"near_far", "near_far_fine", "symmetric"}
    assert all(set(thesis.methods_of(name)) == methods for name in list(thesis.scenes)[:4])
    assert set(thesis.methods_of("light_field")) == {"auto", "symmetric"}
    assert thesis.camera == RUN.camera
    assert thesis.scenes["light_field"].ray_shape == (9, 130, 200)


@pytest.mark.parametrize("text", ["", "# nothing yet\n", "{}"])
def test_an_empty_file_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ConfigError, match=r"\.yaml: is empty; expected"):
        load_config(write(tmp_path, text))


def test_numbers_that_yaml_reads_as_text_are_numbers(tmp_path: Path) -> None:
    # YAML 1.1 reads 1e-4, without a dot, as a string
    text = f"{BARE_TEXT}methods: {{symmetric: {{tolerance: 1e-4}}}}"
    settings = load_config(write(tmp_path, text))
    assert settings.methods["symmetric"].options()["tolerance"] == 1e-4


MISTAKES = """
methods: {symmetric: {tolerence: 1}} -> methods.symmetric.tolerence is unknown; did you mean tolera
methods: {symmetric: {tolerance: 2 s}} -> tolerance is '2 s'; it should be a number
methods: {symmetric: {tolerance: yes}} -> tolerance is true; it should not be true
methods: {dual: {patterns: 9}} -> dual.patterns is unknown; Known here: method, noise_significance,
methods: [dual] -> methods is ['dual']; it should be a section for each method, as in {dual: {}}
methods: {Dual!: {method: dual}} -> methods.Dual! is 'Dual!'; it should match the pattern
camera: {exposures: [15, 125]} -> exposures[1] is 125; it should be at most 60. (Exposure times
camera: {exposures: [1.0, 0.1]} -> camera: exposures is (1.0, 0.1); it should ascend
camera: {black_level_counts: 255, bits: 8} -> camera: black_level_counts is 255; .* 255 at 8 bits
capture: 3 -> capture is 3; it should be a group of 'key: value' settings
capture: {url: 'http://host:99999'} -> capture.url is .* port from 1 to 65535
normalization: all -> normalization is 'all'; it should be 'none', 'per_channel'
notify: mail -s 'done -> notify is .*No closing quotation
scenes: {a: {kind: wegde}} -> scenes.a: 'wegde' is unknown; did you mean wedge? Expected one
scenes: {a: {surfaces: [white]}} -> scenes.a.kind is missing; add it. .*'rfpipe settings scenes'
scenes: {a: {kind: plane, shpae: 8 x 8}} -> scenes.a.shpae is unknown; did you mean shape?
scenes: {a: {kind: wedge, surfaces: white}} -> scenes.a: kind wedge .* 2 surfaces (left, right), not
{camera: {bayer: RGGB}, scenes: {a: {kind: plane, channels: 1}}} -> scenes.a.channels is 1; set it
scenes: {a: {kind: room, methods: {}}} -> scenes.a.methods is {}
scenes: {a: {kind: captured, shape: 4 x 5}} -> a: capture.rig should be remote or
{scenes: {a: &a {kind: captured}, b: *a}, capture: {rig: remote}} -> scenes .* capture.rig remote
{scenes: {a: &a {kind: captured}, b: *a}, capture: {rig: offline}} -> scenes .* capture.rig offline
{scenes: {a: {kind: captured, camera_shape: 6 x 7}},capture: {rig: remote}} -> a.methods: .* rig
scenes: {a: {kind: plane, surfaces: [white], projector: {position: [1, 0, 0]}}} -> a.methods: .* rig
scenes: {a: {kind: room, methods: {duel: }}} -> scenes.a.methods.duel: 'duel' is unknown
scenes: {con: {kind: plane}} -> scenes.con: no folder can have this name on Windows
methods: {lpt1: {method: dual}} -> methods.lpt1: no folder can have this name on Windows
"""


@pytest.mark.parametrize("case", MISTAKES.strip().splitlines())
def test_a_mistake_names_key_value_and_expectation(case: str) -> None:
    text, _, expected = case.partition(" -> ")
    (line,) = message({**BARE, **yaml.safe_load(text)}).splitlines()
    assert line.startswith("mine.yaml: ")
    assert re.search(re.escape(expected).replace(r"\.\*", ".*"), line), line


CAMERAS = """
{camera: {bits: 14, exposures: [0.5]}} -> 14
{camera: {bits: 14}, scenes: {a: {kind: wegde}}, nonsense: 3} -> 14
{camera: {}} -> 12
{camera: null} -> None
"""
NO_CAMERAS = """
{scenes: {}, seed: 3} -> has no section camera, only scenes, seed; expected 'camera:'
{bits: 14} -> has no section camera, only bits
{camera: {bitss: 3}} -> camera.bitss is unknown; did you mean bits?
{camera: {bits: 99}} -> camera.bits is 99; it should be at most 16. (Bits of
{camera: {exposures: [2, 1]}} -> camera: exposures is (2.0, 1.0); it should ascend
{camera: 14 bits} -> camera is '14 bits'; it should be a group
[camera] -> contains ['camera']; expected
{camera: {bits: 14}, camera: {bits: 12}} -> the key 'camera' appears twice
"""


@pytest.mark.parametrize("case", CAMERAS.strip().splitlines())
def test_the_camera_alone_is_read_from_settings(tmp_path: Path, case: str) -> None:
    text, _, expected = case.partition(" -> ")
    camera = load_camera(write(tmp_path, text))
    assert str(camera and camera.bits) == expected


@pytest.mark.parametrize("case", NO_CAMERAS.strip().splitlines())
def test_a_camera_with_mistakes_is_refused(tmp_path: Path, case: str) -> None:
    text, _, expected = case.partition(" -> ")
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=f"{re.escape(str(path))}.*{re.escape(expected)}"):
        load_camera(path)


def test_a_scene_overrides_options_of_the_run() -> None:
    overrides = {"symmetric": {"tolerance": 0.02}}
    settings = parse_config(
        {
            "scenes": {"one": ROOM, "other": {**ROOM, "methods": overrides}},
            "methods": {"symmetric": {"noise_significance": 2}, "dual": {}},
        },
        "mine.yaml",
    )
    assert settings.acquisitions == [
        ("one", "symmetric"),
        ("one", "dual"),
        ("other", "symmetric"),
    ]
    options = settings.methods_of("other")["symmetric"].options()
    assert options == {"noise_significance": 2, "tolerance": 0.02}
    assert settings.methods_of("one")["symmetric"].options()["tolerance"] == 1e-3
    assert parse_config(settings.model_dump(mode="json"), "again") == settings


def test_a_method_can_be_used_twice_under_different_names() -> None:
    fine = {"method": "symmetric", "tolerance": 1e-4}
    settings = parse_config({**BARE, "methods": {"symmetric": {}, "fine": fine}}, "mine.yaml")
    assert list(settings.methods) == ["symmetric", "fine"]
    assert settings.methods["fine"].plugin.name == "symmetric"


@pytest.mark.parametrize(
    ("settings", "is_right"),
    [
        ({"methods": {"near_far": {"target_error": 0.02}, "dual": None}}, True),
        ({"methods": {"own": {"method": "own.py:Own", "width": 2}}}, True),
        ({"methods": {"dual": {"patterns": 100}}}, False),
        ({"methods": {"fine": {"method": "dual", "patterns": 100}}}, False),
        ({"scenes": {"a": {"kind": "room", "surfaces": ["white"] * 3, "views": [2, 2]}}}, True),
        ({"scenes": {"a": {"kind": "own.py:Own", "width": 2}}}, True),
        ({"scenes": {"a": {"kind": "plane", "surfaces": ["white"], "views": [2, 2]}}}, False),
        ({"scenes": {"a": {"kind": "plane", "surfaces": ["wihte"]}}}, False),
        ({"scenes": {"a": {"kind": "wegde", "surfaces": ["white"]}}}, False),
    ],
)
def test_the_schema_contains_the_options_of_every_name(settings: Any, is_right: bool) -> None:
    errors = list(validator(Config).iter_errors({**BARE, **settings}))
    assert (not errors) == is_right


def test_a_wrong_name_of_a_scene_hides_no_other_mistake() -> None:
    scene = {"kind": "wedge", "surfaces": ["texture", "white"], "shape": [6, 8], "channels": 1}
    camera = {"bayer": "RGGB"}  # which is compared with the scene once its name is valid
    output = message({"scenes": {"Small": scene, "LARGE": {**scene, "rig": "x"}}, "camera": camera})
    for expected in (r"scenes\.Small is 'Small'", r"scenes\.LARGE is", r"LARGE\.rig is 'x'"):
        assert re.search(expected, output), output
    output = message({"scenes": {"Small": {**scene, "settings": {"camera": {"bitss": 8}}}}})
    assert re.search(r"Small\.settings\.camera\.bitss is unknown", output), output
    assert "renamed" not in output


def test_every_mistake_is_reported_once() -> None:
    scene = {"kind": "plane", "surfaces": ["wihte"]}
    text = message({"sede": 1, "seed": -1, "scenes": {"mine": scene}})
    assert sorted(line.split(" is ")[0] for line in text.splitlines()) == [
        "mine.yaml: scenes.mine.surfaces[0]",
        "mine.yaml: sede",
        "mine.yaml: seed",
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("seed: 1\nseed: 2\n", "the key 'seed' appears twice"),
        ("seed: [1\n", "is not valid YAML"),
        ("- seed\n", "expected 'key: value' lines"),
        ("? [a, b]\n: 1\n", "found unhashable key"),
        (f"seed: {'9' * 5000}\n", "is not valid YAML"),
        (f"seed: {'[' * 3000}\n", "is not valid YAML"),
        ("seed: 010\n", "010 is ambiguous"),
        ("capture: {warm_up_minutes: 1:30}\n", "1:30 is ambiguous"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, text: str, expected: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(ConfigError, match=expected) as caught:
        load_config(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_file_that_is_not_utf_8_is_named(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes("report: {title: Lumière}".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"latin\.yaml: isn't text .* byte 0xe8"):
        load_config(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^there is no file .*absent\.yaml"):
        load_config(tmp_path / "absent.yaml")
