"""Scenes of Mitsuba as scenes of rfpipe: files, errors, the recording on disk, and LLVM."""

from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from rfpipe.errors import InputError
from rfpipe.mitsuba import recording, variant
from rfpipe.mitsuba.scene import MitsubaOptions, MitsubaScene
from rfpipe.mitsuba.tracing import Tracer
from rfpipe.mitsuba.views import Lens
from rfpipe.store.manifest import read_manifest
from rfpipe.testing import SceneContract

LOOKING = """
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
<lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform></sensor>"""
ASIDE = """
<emitter type="projector"><float name="fov" value="40"/><transform name="to_world">
<lookat origin="1.5,0,3.5" target="0,0,0" up="0,1,0"/></transform></emitter>"""
THINGS = """
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-1"/></transform>
<bsdf type="diffuse"/><emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>
<shape type="sphere"><float name="radius" value="0.5"/><bsdf type="roughplastic"/></shape>
<emitter type="constant"/>"""

needs_llvm = pytest.mark.needs("llvm")


def options(tmp_path: Path, scene: str | Path = "two_blocks", **given) -> MitsubaOptions:
    small = {"shape": (6, 8), "samples": 64, "cache": str(tmp_path / "cache")}
    return MitsubaOptions.of("mitsuba", scene=str(scene), **(small | given))


def file_of(tmp_path: Path, *parts: str) -> Path:
    path = tmp_path / "own.xml"
    path.write_text(f"<scene version='3.0.0'>{''.join(parts)}</scene>")
    return path


def pictures(settings: MitsubaOptions) -> np.ndarray:
    rays = int(np.prod(settings.ray_shape))
    return MitsubaScene(settings).apply(np.eye(3, rays, dtype=np.float32) + np.float32(0.5))


@needs_llvm
class TestTwoBlocks(SceneContract):
    @pytest.fixture(autouse=True)
    def _cache(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        self.folder = tmp_path_factory.getbasetemp() / "two_blocks"

    def make_scene(self):
        return MitsubaScene(options(self.folder))


@needs_llvm
class TestAside(TestTwoBlocks):
    coaxial = False

    def make_scene(self):
        view = {"origin": (2.2, 0, 3.2), "target": (0, 0, 0), "degrees": 39.3}
        given = {"projectors": [view], "projector_shape": (5, 7)}
        return MitsubaScene(options(self.folder, **given))


@needs_llvm
def test_a_file_has_a_separate_projector_and_its_lights_are_ignored(tmp_path: Path) -> None:
    settings = options(tmp_path, file_of(tmp_path, LOOKING, ASIDE, THINGS))
    assert not settings.is_coaxial
    assert settings.projector_side.pinholes[0].position == (1.5, 0, 3.5)
    assert pictures(settings).max() > 0.1
    assert MitsubaScene(settings).apply(np.zeros((1, 48))).max() == 0


@needs_llvm
def test_a_file_has_a_camera_with_a_lens(tmp_path: Path) -> None:
    lens = "<float name='aperture_radius' value='0.1'/><float name='focus_distance' value='3.5'/>"
    sensor = LOOKING.replace("perspective", "thinlens").replace("</sensor>", f"{lens}</sensor>")
    settings = options(tmp_path, file_of(tmp_path, sensor, ASIDE, THINGS))
    assert settings.camera_side.lenses == (Lens(0.2, 3.5),)
    assert settings.projector_side.lenses == ()


@needs_llvm
def test_a_file_without_projector_is_coaxial_and_its_transport_symmetric(tmp_path: Path) -> None:
    settings = options(tmp_path, file_of(tmp_path, LOOKING, THINGS))
    assert settings.is_coaxial
    transport = MitsubaScene(settings).dense(1)
    np.testing.assert_array_equal(transport, transport.T)
    assert transport.max() > 0.1


@needs_llvm
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scene": "nonesuch"}, "two_blocks"),
        ({"scene": "no.xml"}, "can't be read"),
        ({"parts": (THINGS,)}, "no sensor of type perspective"),
        ({"parts": (LOOKING, "<shape type='nonesuch'/>")}, "nonesuch"),
        ({"parts": (LOOKING,)}, "no shape"),
        ({"parts": (LOOKING.replace("<lookat", "<scale x='-1' y='1' z='1'/><lookat"),)}, "mirrors"),
        # the camera looks away or is inside a block
        ({"projectors": [{"origin": (0, 0, 4), "target": (0, 0, 9)}]}, "no light reaches"),
        ({"cameras": [{"origin": (-0.33, -0.4, -0.28), "target": (0, 0, 9)}]}, "no light reaches"),
        ({"cameras": [{"origin": (0, 0, 0), "target": (0, 2, 0)}]}, "another point to look at"),
    ],
)
def test_invalid_scenes_and_rigs_are_refused(tmp_path: Path, given: dict, message: str) -> None:
    parts = given.pop("parts", None)
    if parts:
        given["scene"] = file_of(tmp_path, *parts)
    with pytest.raises((ValidationError, InputError), match=message):
        pictures(options(tmp_path, **given))


@needs_llvm
def test_a_recording_is_reused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = pictures(options(tmp_path, bounces=2))
    scene = MitsubaScene(options(tmp_path, bounces=2))
    facts = read_manifest(scene.recording.folder / "matrix.json")
    assert facts["light"]["bounces"] == 2
    assert "mitsuba" in facts["versions"]
    monkeypatch.setattr(recording, "_record", None)
    np.testing.assert_array_equal(pictures(options(tmp_path, bounces=2)), first)
    with pytest.raises(TypeError):
        pictures(options(tmp_path, bounces=2, seed=1))


@needs_llvm
def test_an_interrupted_recording_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    complete = pictures(options(tmp_path / "whole"))
    monkeypatch.setattr(recording, "_PIECE_BYTES", 16 * 48 * 16)  # three pieces
    pieced = pictures(options(tmp_path / "pieced"))
    # other pieces use other random numbers
    assert 0 < np.linalg.norm(pieced - complete) < 0.1 * np.linalg.norm(complete)
    rows, traced = Tracer.rows, []

    def stopping(tracer, half, first, last):
        traced.append(first)
        if len(traced) == 5:
            raise KeyboardInterrupt
        return rows(tracer, half, first, last)

    stopping.__name__ = "rows"
    monkeypatch.setattr(Tracer, "rows", stopping)
    with pytest.raises(KeyboardInterrupt):
        pictures(options(tmp_path))
    np.testing.assert_array_equal(pictures(options(tmp_path)), pieced)
    assert traced == [0, 0, 16, 16, 32, 32, 32]  # one of the halves of a piece


@needs_llvm
def test_estimated_noise_matches_the_difference_of_two_seeds(tmp_path: Path) -> None:
    lit = np.zeros((1, 12, 16), dtype=np.float32)
    lit[..., :8] = 1
    scenes = [
        MitsubaScene(options(tmp_path, shape=(12, 16), samples=256, seed=seed)) for seed in (0, 1)
    ]
    first, second = (scene.apply(lit).astype(np.float64) for scene in scenes)
    estimated = np.hypot(*(scene.recorded["grain"]["whole"] for scene in scenes))
    assert {"mitsuba", "drjit", "llvm"} < set(scenes[0].recorded["versions"])
    apart = np.linalg.norm(first - second) / np.linalg.norm((first + second) / 2)
    assert estimated / 1.5 < apart < estimated * 1.5


def test_the_newest_supported_llvm_is_selected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "libLLVM-15.so.1").touch()
    monkeypatch.setattr(variant, "_PATTERNS", (f"{tmp_path}/libLLVM*",))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    assert variant.usable_llvm() is None
    (tmp_path / "libLLVM.so.19.1").touch()
    (tmp_path / "libLLVM.so.22.1").touch()
    assert variant.usable_llvm() == tmp_path / "libLLVM.so.22.1"
    for name, usable in (("libLLVM.so.19.1", True), ("libLLVM-15.so.1", False)):
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / name))
        assert variant.usable_llvm() == (tmp_path / name if usable else None)


def test_without_llvm_a_transport_is_not_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "none")
    with pytest.raises(InputError, match=r"two_blocks.*libllvm19.*DRJIT_LIBLLVM_PATH"):
        MitsubaScene(options(tmp_path)).apply(np.ones((1, 48)))
