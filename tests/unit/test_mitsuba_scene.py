"""Scenes of Mitsuba as scenes of rfpipe: files, errors, and the recording on disk."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from rfpipe.errors import InputError
from rfpipe.store.manifest import read_manifest
from rfpipe.testing import SceneContract
from rfpipe_mitsuba import recording
from rfpipe_mitsuba.kind import Mitsuba, MitsubaOptions

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


pytestmark = pytest.mark.needs("llvm")


def options(tmp_path: Path, scene: str | Path = "two_blocks", **given) -> MitsubaOptions:
    small = {"shape": (6, 8), "samples": 64, "cache": str(tmp_path / "cache")}
    return MitsubaOptions.of("mitsuba", scene=str(scene), **(small | given))


def file_of(tmp_path: Path, *parts: str) -> Path:
    path = tmp_path / "own.xml"
    path.write_text(f"<scene version='3.0.0'>{''.join(parts)}</scene>")
    return path


def pictures(settings: MitsubaOptions) -> np.ndarray:
    rays = int(np.prod(settings.ray_shape))
    return Mitsuba.make(settings).apply(np.eye(3, rays, dtype=np.float32) + np.float32(0.5))


class TestTwoBlocks(SceneContract):
    @pytest.fixture(autouse=True)
    def _cache(self, tmp_path_factory: pytest.TempPathFactory) -> None:
        self.folder = tmp_path_factory.getbasetemp() / "two_blocks"

    def make_scene(self):
        return Mitsuba.make(options(self.folder))


class TestAside(TestTwoBlocks):
    coaxial = False

    def make_scene(self):
        view = {"origin": (2.2, 0, 3.2), "target": (0, 0, 0), "degrees": 39.3}
        given = {"projectors": [view], "projector_shape": (5, 7)}
        return Mitsuba.make(options(self.folder, **given))


def test_a_file_s_projector_stands_aside_and_its_other_lights_are_left_out(tmp_path: Path) -> None:
    settings = options(tmp_path, file_of(tmp_path, LOOKING, ASIDE, THINGS), samples=4096)
    assert not settings.is_coaxial
    recorded = pictures(settings)
    rendered = pictures(settings.model_copy(update={"light": "rendered"}))
    assert np.linalg.norm(recorded - rendered) < 0.05 * np.linalg.norm(rendered)
    assert Mitsuba.make(settings).apply(np.zeros((1, 48))).max() == 0


def test_a_file_without_projector_is_coaxial_and_its_transport_symmetric(tmp_path: Path) -> None:
    settings = options(tmp_path, file_of(tmp_path, LOOKING, THINGS))
    assert settings.is_coaxial
    transport = Mitsuba.make(settings).dense(1)
    np.testing.assert_array_equal(transport, transport.T)
    assert transport.max() > 0.1


def test_a_description_as_json(tmp_path: Path) -> None:
    path = tmp_path / "own.json"
    wall = {
        "type": "rectangle",
        "to_world": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1]],
    }
    view = {
        "type": "perspective",
        "fov": 30.0,
        "to_world": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]],
    }
    path.write_text(json.dumps({"type": "scene", "wall": wall, "eye": view}))
    assert pictures(options(tmp_path, path)).min() > 0.1


def test_a_name_and_a_file_that_are_none(tmp_path: Path) -> None:
    for scene, said in (("nonesuch", "two_blocks"), (tmp_path / "no.xml", "can't be read")):
        with pytest.raises(ValidationError, match=said):
            options(tmp_path, scene)


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ((THINGS,), "no sensor of type perspective"),
        ((LOOKING, "<shape type='nonesuch'/>"), "nonesuch"),
        ((LOOKING,), "no shape"),
        ((LOOKING, "<shape"), "can't make it"),
        ((LOOKING.replace("<lookat", "<scale x='-1' y='1' z='1'/><lookat"),), "mirrors"),
    ],
)
def test_a_file_that_is_wrong(tmp_path: Path, parts: tuple[str, ...], said: str) -> None:
    with pytest.raises((ValidationError, InputError), match=said):
        pictures(options(tmp_path, file_of(tmp_path, *parts)))


@pytest.mark.parametrize(
    "views",
    [
        {"projectors": [{"origin": (0, 0, 4), "target": (0, 0, 9)}]},  # looks away
        {"cameras": [{"origin": (-0.33, -0.4, -0.28), "target": (0, 0, 9)}]},  # within a block
    ],
)
def test_a_rig_that_sees_no_light(tmp_path: Path, views: dict) -> None:
    with pytest.raises(InputError, match="no light comes back to the camera"):
        pictures(options(tmp_path, **views))


def test_what_was_recorded_is_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = pictures(options(tmp_path))
    monkeypatch.setattr(recording, "_record", None)
    np.testing.assert_array_equal(pictures(options(tmp_path)), first)
    with pytest.raises(TypeError):
        pictures(options(tmp_path, seed=1))


def test_a_recording_that_was_stopped_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = pictures(options(tmp_path / "whole"))
    monkeypatch.setattr(recording, "_PIECE_BYTES", 16 * 48 * 24)  # three pieces
    pieced = pictures(options(tmp_path / "pieced"))
    # Other pieces draw other random numbers.
    assert 0 < np.linalg.norm(pieced - whole) < 0.1 * np.linalg.norm(whole)
    done = []

    def stop(message: str) -> None:
        done.append(message)
        if len(done) == 2:
            raise KeyboardInterrupt

    scene = Mitsuba.make(options(tmp_path))
    folder = next((tmp_path / "pieced" / "cache").iterdir()).name
    arguments = (lambda: recording_scene(scene), scene.camera, scene.projector, scene.light)
    with pytest.raises(KeyboardInterrupt):
        recording.record(*arguments, scene.cache / folder, coaxial=True, progress=stop)
    np.testing.assert_array_equal(scene.apply(np.eye(48)), _columns(tmp_path / "pieced"))
    assert len(done) == 2


def recording_scene(scene):
    from rfpipe_mitsuba.world import load_scene

    return load_scene(scene.world)


def _columns(folder: Path) -> np.ndarray:
    return Mitsuba.make(options(folder)).apply(np.eye(48))


def test_two_that_want_a_recording_make_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, record = [], recording._record
    monkeypatch.setattr(recording, "_record", lambda *a: (made.append(1), record(*a)))
    monkeypatch.setattr(recording, "_WAIT_SECONDS", 0.01)
    settings = options(tmp_path)
    threads = [threading.Thread(target=pictures, args=(settings,)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1


def test_the_noise_that_is_told_is_that_of_another_seed(tmp_path: Path) -> None:
    lit = np.zeros((1, 12, 16), dtype=np.float32)
    lit[..., :8] = 1
    scenes = [
        Mitsuba.make(options(tmp_path, shape=(12, 16), samples=256, seed=seed)) for seed in (0, 1)
    ]
    one, other = (scene.apply(lit).astype(np.float64) for scene in scenes)
    told = np.hypot(*(scene.recording.noise["half_lit"]["whole"] for scene in scenes))
    found = np.linalg.norm(one - other) / np.linalg.norm((one + other) / 2)
    assert told / 1.5 < found < told * 1.5


def test_the_manifest_names_versions_and_light(tmp_path: Path) -> None:
    scene = Mitsuba.make(options(tmp_path, bounces=2))
    found = read_manifest(scene.recording.folder / "recording.json")
    assert found["light"]["bounces"] == 2
    assert "mitsuba" in found["versions"]
