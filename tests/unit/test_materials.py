"""Tracing parameters chosen by the materials of a Mitsuba file: caustics, bounces, omissions."""

from pathlib import Path

import pytest
import yaml
from tests.results.report_folders import acquired
from tests.rigs.known_matrix import run
from tests.unit.test_mitsuba_scene import ASIDE, LOOKING, file_of, options

from rfpipe.config import Config
from rfpipe.errors import InputError
from rfpipe.mitsuba.materials import choose_caustics, shape_materials
from rfpipe.mitsuba.scene import MitsubaOptions
from rfpipe.mitsuba.world import load_scene
from rfpipe.mitsuba.worlds import WORLDS
from rfpipe.store import read_manifest

FLOOR = "<shape type='rectangle' id='floor'><bsdf type='diffuse'/></shape>"
FOG = """<medium type="homogeneous" name="interior"><rgb name="albedo" value="0.9"/>
<float name="sigma_t" value="5"/></medium>"""
CLOUD = """<medium type="heterogeneous" name="interior"><volume type="constvolume" name="albedo">
<rgb name="value" value="0.9"/></volume><volume type="constvolume" name="sigma_t">
<float name="value" value="5"/></volume></medium>"""
GRAIN = "<texture type='checkerboard' name='texture'/>"


def bsdf(kind: str, *nested: str, **floats: float) -> str:
    numbers = (f"<float name='{name}' value='{value}'/>" for name, value in floats.items())
    return f"<bsdf type='{kind}'>{''.join((*nested, *numbers))}</bsdf>"


MIRROR, MATT, GLASS = bsdf("conductor"), bsdf("diffuse"), bsdf("dielectric")

MATERIALS = {  # material of a ball on a matt floor: caustics, bounces
    "matt": (MATT, False, 6),
    "rough plastic": (bsdf("roughplastic"), False, 6),
    "rough metal": (bsdf("roughconductor", alpha=0.2), False, 6),
    "principled": (bsdf("principled"), False, 6),
    "rough glass": (bsdf("roughdielectric", alpha=0.2), False, 10),
    "nothing": (bsdf("null"), False, 6),
    "mask of matt": (bsdf("mask", MATT, opacity=0.5), False, 6),
    "glass": (GLASS, True, 10),
    "thin glass": (bsdf("thindielectric"), True, 6),
    "mirror": (MIRROR, True, 6),
    "smooth plastic": (bsdf("plastic"), True, 6),
    "two sides": (bsdf("twosided", MIRROR), True, 6),
    "mask": (bsdf("mask", MIRROR, opacity=0.5), True, 6),
    "mask of glass": (bsdf("mask", GLASS, opacity=0.5), True, 10),
    "blend": (bsdf("blendbsdf", MATT, MIRROR, weight=0.2), True, 6),
    "bumps": (bsdf("bumpmap", GRAIN, MIRROR), True, 6),
    "normal map": (bsdf("normalmap", GRAIN.replace("'texture'", "'normalmap'"), MIRROR), True, 6),
    "nested": (bsdf("mask", bsdf("blendbsdf", MATT, MIRROR, weight=0.2), opacity=0.5), True, 6),
    "nested twice": (bsdf("twosided", bsdf("bumpmap", GRAIN, bsdf("plastic"))), True, 6),
    "fog": (bsdf("null") + FOG, False, 48),
    "glass with fog": (GLASS + FOG, True, 48),
}


def ball(material: str) -> str:
    return f"<shape type='sphere' id='ball'>{material}</shape>"


def of_ball(tmp_path: Path, material: str, *parts: str, **given) -> MitsubaOptions:
    return options(tmp_path, file_of(tmp_path, LOOKING, FLOOR, ball(material), *parts), **given)


def chosen(settings: MitsubaOptions) -> dict:
    return {choice.setting: choice.value for choice in settings.choices}


@pytest.mark.parametrize("rig", ["coaxial", "aside"])
@pytest.mark.parametrize("name", MATERIALS)
def test_null_is_chosen_by_the_materials_of_a_file(tmp_path: Path, name: str, rig: str) -> None:
    material, caustics, bounces = MATERIALS[name]
    settings = of_ball(tmp_path, material, *([ASIDE] if rig == "aside" else []))
    light = settings.light
    assert (light.caustics, light.bounces) == (caustics, bounces)
    projectors = "coaxial" if rig == "coaxial" else "the file's"
    expected = {"projectors": projectors, "bounces": bounces, "caustics": caustics}
    assert chosen(settings) == expected
    reasons = {choice.setting: choice.reason for choice in settings.choices}
    assert ("ball" in reasons["caustics"]) == caustics
    assert ("ball" in reasons["bounces"]) == (bounces > 6)
    assert "floor" not in " ".join(reasons.values())


def test_glass_in_a_group_of_shapes_counts_and_unused_glass_does_not(tmp_path: Path) -> None:
    group = f"<shape type='shapegroup' id='group'>{ball(GLASS)}</shape>"
    shown = "<shape type='instance'><ref id='group'/></shape>"
    in_group = options(tmp_path, file_of(tmp_path, LOOKING, FLOOR, group, shown))
    assert (in_group.light.caustics, in_group.light.bounces) == (True, 10)
    unused = GLASS.replace("<bsdf", "<bsdf id='unused'", 1)
    assert not of_ball(tmp_path, MATT, unused).light.caustics


@pytest.mark.parametrize(
    ("given", "value"), [({"caustics": False}, False), ({"caustics": True}, True)]
)
def test_explicit_settings_are_used_and_not_listed_as_choices(tmp_path, given, value) -> None:
    settings = of_ball(tmp_path, GLASS, bounces=4, **given)
    assert (settings.light.caustics, settings.light.bounces) == (value, 4)
    assert set(chosen(settings)) == {"projectors"}


def test_direct_light_has_no_caustics(tmp_path: Path) -> None:
    settings = of_ball(tmp_path, GLASS, bounces=1)
    assert chosen(settings)["caustics"] is False
    assert settings.omissions == []


OMISSIONS = {  # material, options, words of the sentence that names the ball; "" for no sentence
    "caustics": (GLASS, {"caustics": False}, "caustics is false"),
    "light": (GLASS, {}, ""),
    "sharp metal": (bsdf("roughconductor", alpha=0.001), {}, "alpha"),
    "sharp in one direction": (bsdf("roughconductor", alpha_u=0.001, alpha_v=0.2), {}, ""),
    "sharp glass": (bsdf("roughdielectric", alpha=0.01), {}, "alpha"),
    "sharp principled": (bsdf("principled", roughness=0.1), {}, "alpha"),
    "sharp under a mask": (
        bsdf("mask", bsdf("roughconductor", alpha=0.01), opacity=0.5), {}, "alpha"
    ),
    "sharp, direct light": (bsdf("roughconductor", alpha=0.001), {"bounces": 1}, ""),
    "rough": (bsdf("roughconductor", alpha=0.1), {}, ""),
    "fog": (bsdf("null") + FOG, {}, ""),
    "glass with fog": (GLASS + FOG, {}, "boundary of the medium"),
}  # fmt: skip


@pytest.mark.parametrize("name", OMISSIONS)
def test_omitted_light_is_described(tmp_path: Path, name: str) -> None:
    material, given, words = OMISSIONS[name]
    omissions = of_ball(tmp_path, material, **given).omissions
    assert len(omissions) == bool(words)
    assert all("ball" in sentence and words in sentence for sentence in omissions)


def test_a_heterogeneous_medium_is_refused(tmp_path: Path) -> None:
    settings = of_ball(tmp_path, bsdf("null") + CLOUD)
    with pytest.raises(InputError, match=r"own: ball .*heterogeneous.*make it homogeneous"):
        _ = settings.light


@pytest.mark.parametrize("name", WORLDS)
def test_scenes_declare_the_parameters_of_their_materials(name: str) -> None:
    world, surfaces = WORLDS[name], shape_materials(load_scene(WORLDS[name]))
    assert world.caustics == choose_caustics(surfaces, world.bounces).value
    assert not any(surface.is_sharp or surface.is_graded for surface in surfaces)


def written(tmp_path: Path, material: str) -> Path:
    """Write the settings of a run of one file, and the file."""
    path = file_of(tmp_path, LOOKING, FLOOR, ball(material))
    scene = {"kind": "mitsuba", "scene": str(path), "shape": [4, 5], "samples": 16}
    run_of = {"scenes": {"bowl": scene}, "methods": {"brute_force": {}}, "camera": None}
    settings = tmp_path / "config.yaml"
    settings.write_text(yaml.safe_dump(run_of))
    return settings


def test_plan_lists_choices_and_missing_software(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "none")
    planned = run("plan", written(tmp_path, GLASS), "--directory", tmp_path)
    assert "valid" in planned
    assert "bowl: chosen: projectors coaxial" in planned
    assert "caustics true (light is reflected or refracted smoothly by ball" in planned
    assert "apt-get install libllvm19" in planned
    assert "DRJIT_LIBLLVM_PATH" in planned


@pytest.mark.needs("llvm")
def test_plan_lists_nothing_missing_for_a_recordable_or_recorded_scene(
    tmp_path, monkeypatch
) -> None:
    settings = written(tmp_path, MATT)
    assert "can't run here" not in run("plan", settings, "--directory", tmp_path)
    monkeypatch.chdir(tmp_path)
    config = Config.model_validate(yaml.safe_load(settings.read_text()))
    acquired(tmp_path / "results", config)
    facts = read_manifest(tmp_path / "results" / "bowl" / "brute_force" / "relight.json")
    assert [choice["setting"] for choice in facts["light"]["choices"]] == [
        "projectors", "bounces", "caustics",
    ]  # fmt: skip
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "none")
    assert "can't run here" not in run("plan", settings)
