"""Light of physically based scenes compared with analytic results and Mitsuba's integrators."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from rfpipe.errors import InputError
from rfpipe.mitsuba.parts import (
    ball,
    box,
    glass,
    lettering,
    matt,
    mirror,
    sheet,
    textured,
)
from rfpipe.mitsuba.recording import dense
from rfpipe.mitsuba.rendering import hits
from rfpipe.mitsuba.scene import MitsubaOptions, MitsubaScene
from rfpipe.mitsuba.variant import load_mitsuba
from rfpipe.mitsuba.views import View
from rfpipe.mitsuba.world import World, load_scene
from rfpipe.mitsuba.worlds import WORLDS, view
from rfpipe.scenes.pinholes import Pinhole

SIZE = 12
AHEAD = view((0, 0, 3), (0, 0, 0), 20)
LETTER = textured(lettering(["F"]))


pytestmark = pytest.mark.needs("llvm")


def world(*shapes, camera=AHEAD, projector=None, **given) -> World:
    described = {"type": "scene"} | {f"shape_{k}": shape for k, shape in enumerate(shapes)}
    return World("own", lambda: described, (camera,), projector and (projector,), **given)


def scene_of(tmp_path: Path, of: World, samples: int = 256, **given) -> MitsubaScene:
    fixed = {"shape": (SIZE, SIZE), "samples": samples, "cache": str(tmp_path / "cache")} | given
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(WORLDS, of.name, of)
        return MitsubaScene(MitsubaOptions(kind="mitsuba", scene=of.name, **fixed))


def flood(scene: MitsubaScene) -> np.ndarray:
    picture = scene.apply(np.ones((1, scene.projector.rays)))[0].astype(np.float64)
    return picture.reshape(-1, SIZE, SIZE, 3)[0]


def half_lit(scene: MitsubaScene) -> np.ndarray:
    return scene.apply(half_pattern(scene)[None])[0].astype(np.float64).reshape(SIZE, SIZE, 3)


def half_pattern(scene: MitsubaScene) -> np.ndarray:
    pattern = np.zeros(scene.projector.domain)
    pattern[..., : SIZE // 2] = 1
    return pattern.ravel()


def differ(actual: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


def rendered(
    scene: MitsubaScene,
    pattern: np.ndarray,
    integrator: dict | None = None,
    times: int = 1,
) -> np.ndarray:
    """Render a picture by Mitsuba's projector, camera and integrator, with `times` the samples."""
    mi = load_mitsuba()
    shapes = load_scene(scene.world)
    media = any(shape.is_medium_transition() for shape in shapes.shapes())
    depth = scene.light.bounces + 1
    by_paths = {"type": "volpath" if media else "path"}
    weights = pattern.reshape(SIZE, SIZE, 1).repeat(3, 2).astype(np.float32)
    lamp = {"type": "bitmap", "bitmap": mi.Bitmap(weights), "raw": True, "filter_type": "nearest"}
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}

    def placed(kind: str, pinhole: Pinhole) -> dict:
        at = mi.ScalarTransform4f().look_at(pinhole.position, pinhole.look_at, pinhole.up)
        degrees = 2 * np.degrees(np.arctan(pinhole.pitch * SIZE / 2))
        return {"type": kind, "to_world": at, "fov": float(degrees)}

    camera = placed("perspective", scene.camera.pinholes[0])
    for lens in scene.camera.lenses:
        camera |= {"type": "thinlens", "focus_distance": lens.focus}
        camera |= {"aperture_radius": lens.aperture / 2}
    described = {
        "type": "scene",
        "integrator": (integrator or by_paths) | {"max_depth": depth},
        "camera": camera | {"film": film},
        "light": placed("projector", scene.projector.pinholes[0]) | {"irradiance": lamp},
    } | {f"shape_{k}": shape for k, shape in enumerate(shapes.shapes())}
    picture = mi.render(mi.load_dict(described), spp=times * scene.light.samples)
    # a projector of Mitsuba's lights a surface at distance 1 so that white has radiance 1
    return np.array(picture, np.float64)[..., :3] * scene.recording.scale / np.pi


@pytest.mark.parametrize("name", ["two_blocks_aside", "glossy_metal", "translucent"])
def test_recorded_light_equals_mitsubas_renderings(tmp_path: Path, name: str) -> None:
    scene = scene_of(tmp_path, WORLDS[name], samples=1024, caustics=False)
    picture, expected = half_lit(scene), rendered(scene, half_pattern(scene))
    assert picture.sum() == pytest.approx(expected.sum(), rel=0.01)
    noise = scene.recording.noise["half_lit"]["whole"]
    assert differ(picture, expected) < 3 * np.sqrt(2) * noise


def test_a_matt_plane_has_its_albedo_as_radiance(tmp_path: Path) -> None:
    plane = sheet((0, 0, 0), (2, 0, 0), (0, 2, 0), matt(0.2, 0.5, 0.8))
    picture = flood(scene_of(tmp_path, world(plane)))
    np.testing.assert_allclose(picture.mean(axis=(0, 1)), (0.2, 0.5, 0.8), rtol=1e-3)
    # pixels differ by the fraction of their paths that end in neighbours
    np.testing.assert_allclose(picture, np.broadcast_to((0.2, 0.5, 0.8), picture.shape), rtol=0.01)


@pytest.mark.parametrize("bounces", [2, 5])
def test_light_within_a_sphere_is_uniform(tmp_path: Path, bounces: int) -> None:
    """In an integrating sphere all pairs of points exchange the same light."""
    albedo, radius = 0.7, 2.0
    inside = {"type": "twosided", "material": matt(albedo)}
    centre = view((0, 0, 0), (0, 0, -1), 60)
    hollow = world(ball((0, 0, 0), radius, inside), camera=centre, bounces=bounces)
    scene = scene_of(tmp_path, hollow, 4096)
    flux = scene.recording.scale * (2 * np.tan(np.radians(30))) ** 2 / 2
    irradiance = flux * (albedo - albedo**bounces) / (1 - albedo) / (4 * np.pi * radius**2)
    dark = half_lit(scene)[:, SIZE // 2 + 1 :]
    assert dark.mean() == pytest.approx(albedo / np.pi * irradiance, rel=0.01)
    assert dark.std() < 0.1 * dark.mean()


def test_the_first_row_of_a_texture_is_on_top(tmp_path: Path) -> None:
    picture = np.full((64, 64, 3), 0.1, dtype=np.float32)
    picture[:32] = 0.8  # above
    picture[:, :32, 0] = 0.5  # red, at the left
    plane = sheet((0, 0, 0), (0.6, 0, 0), (0, 0.6, 0), textured(picture))
    image = flood(scene_of(tmp_path, world(plane), bounces=1))
    assert image[:3, 6:, 1].mean() > 5 * image[-3:, 6:, 1].mean()
    assert image[:, :3, 0].mean() == pytest.approx(0.5, rel=0.03)


# A mirror at 45 degrees shows a wall at the right as seen from the mirror image of the camera.
MIRROR = sheet((0, 0, 0), (0.8, 0, -0.8), (0, 0.8, 0), mirror(0.9))
WALL = sheet((2, 0, 0), (0, 0, 1), (0, 1, 0), LETTER)
IMAGE_OF_AHEAD = view((-3, 0, 0), (0, 0, 0), 20)
OTHER = view((0.5, 2.5, 0.3), (2, 0, 0), 60)


def test_a_mirror_shows_the_picture_from_behind_it(tmp_path: Path) -> None:
    by_mirror = scene_of(tmp_path, world(MIRROR, WALL, projector=OTHER, bounces=2))
    directly = scene_of(tmp_path, world(WALL, camera=IMAGE_OF_AHEAD, projector=OTHER, bounces=1))
    reflected, expected = half_lit(by_mirror), half_lit(directly)[:, ::-1] * 0.9
    assert differ(reflected, expected) < 0.03
    assert differ(reflected, expected[:, ::-1]) > 0.1  # the letter isn't mirror-symmetric


def test_a_mirror_reflects_a_pattern_as_a_virtual_projector(tmp_path: Path) -> None:
    thrown = world(MIRROR, WALL, camera=OTHER, projector=AHEAD, bounces=2, caustics=True)
    by_mirror = scene_of(tmp_path, thrown, 1024)
    directly = scene_of(
        tmp_path, world(WALL, camera=OTHER, projector=IMAGE_OF_AHEAD, bounces=1), 1024
    )
    reflected, expected = (
        scene.dense(1).reshape(SIZE * SIZE, SIZE, SIZE) / scene.recording.scale
        for scene in (by_mirror, directly)
    )
    assert expected.max() > 0
    mirrored, direct = (
        reflected[..., : SIZE // 2].sum(axis=(1, 2)),
        expected[..., SIZE // 2 :].sum(axis=(1, 2)),
    )
    assert differ(mirrored, 0.9 * direct) < 0.05
    assert mirrored.sum() == pytest.approx(0.9 * direct.sum(), rel=0.01)
    without = scene_of(tmp_path, thrown, caustics=False)
    ones = np.ones((1, SIZE * SIZE))
    with (
        pytest.warns(UserWarning, match="caustics is false"),
        pytest.raises(InputError, match="no light reaches"),
    ):
        without.apply(ones)


WHITE = sheet((2, 0, 0), (0, 0, 2), (0, 2, 0), matt(0.5))
INNER = slice(1, -1)  # pixels that a blur by one pixel gives no light from outside the picture


def test_light_through_a_mirror_both_ways_equals_the_virtual_rig(tmp_path: Path) -> None:
    both_ways = scene_of(tmp_path, world(MIRROR, WHITE, bounces=3, caustics=True), 4096)
    directly = scene_of(tmp_path, world(WHITE, camera=IMAGE_OF_AHEAD, bounces=1), 4096)
    reflected, expected = (
        flood(scene)[INNER, INNER] / scene.recording.scale for scene in (both_ways, directly)
    )
    expected = 0.9**2 * expected[:, ::-1]
    assert reflected.sum() == pytest.approx(expected.sum(), rel=0.01)
    assert differ(reflected, expected) < 2 * both_ways.recording.noise["half_lit"]["whole"]
    # the footprint of a pixel reaches at most into the next pixels, with most of its light inside
    rows, columns = np.indices((SIZE, SIZE)).reshape(2, -1)
    apart = np.maximum(abs(rows[:, None] - rows), abs(columns[:, None] - columns))
    entries = both_ways.dense(1)
    assert entries[apart > 1].sum() < 1e-3 * entries.sum()
    assert entries[apart == 0].sum() > 0.6 * entries.sum()
    too_short = scene_of(tmp_path, world(MIRROR, WHITE, bounces=2, caustics=True))
    with pytest.raises(InputError, match="no light reaches"):
        too_short.apply(np.ones((1, SIZE * SIZE)))


REFLECTED = 0.2**2  # reflectance of one boundary of glass of index 1.5


def test_a_plane_behind_glass_has_the_transmitted_radiance(tmp_path: Path) -> None:
    thick, away = 0.2, 3
    plane = sheet((0, 0, 0), (3, 0, 0), (0, 3, 0), matt(0.1))
    plate = box((0, 0, 1), (4, 4, thick), 0, glass(1.5))
    glazed = world(plane, plate, bounces=10, caustics=True)
    scenes = scene_of(tmp_path, glazed, 4096), scene_of(tmp_path, world(plane, bounces=1), 4096)
    mean_radiance, expected = (
        flood(scene)[INNER, INNER].mean() / scene.recording.scale for scene in scenes
    )
    passed = (1 - REFLECTED) / (1 + REFLECTED)  # including multiple reflections inside the glass
    nearer = away / (away - thick * (1 - 1 / 1.5))
    assert mean_radiance / expected == pytest.approx(passed**2 * nearer**2, rel=0.02)


FLOOR_AND_WALL = (
    sheet((0, -1, 0), (4, 0, 0), (0, 0, -4), matt(0.7)),
    sheet((0, 0, -1.4), (4, 0, 0), (0, 4, 0), matt(0.6)),
)
IN_FRONT, BESIDE = view((0, 1.2, 4), (0, -0.3, 0), 38), view((2.8, 1.6, 2.6), (0, -0.5, 0), 38)


def traced_from_the_projector(scene: MitsubaScene) -> np.ndarray:
    """Render the floodlit picture of directly visible surfaces by Mitsuba's particle tracer."""
    return rendered(scene, np.ones(SIZE * SIZE), {"type": "ptracer"}, 16)


@pytest.mark.slow
@pytest.mark.parametrize("beside", [None, BESIDE], ids=["coaxial", "aside"])
@pytest.mark.parametrize("material", [glass(), mirror()], ids=["glass", "mirror"])
def test_a_caustic_equals_mitsubas_particle_tracer(
    tmp_path: Path, material: dict, beside: View | None
) -> None:
    of = world(
        *FLOOR_AND_WALL,
        ball((0, -0.4, 0), 0.5, material),
        camera=IN_FRONT,
        projector=beside,
        bounces=6,
    )
    scene = scene_of(tmp_path, of, 4096)
    assert scene.light.caustics
    distances, normals = hits(load_scene(of), scene.camera.pinholes[0])
    on_ball = np.abs(normals).max(axis=1).reshape(SIZE, SIZE) < 0.999
    around = ~binary_dilation(on_ball, np.ones((3, 3)))
    assert np.isfinite(distances).all()
    assert 0 < around.sum() < SIZE * SIZE
    expected = traced_from_the_projector(scene)[around].sum()
    assert flood(scene)[around].sum() == pytest.approx(expected, rel=0.01)
    without = scene_of(tmp_path, of, 4096, caustics=False)
    with pytest.warns(UserWarning, match="caustics is false"):
        assert flood(without)[around].sum() < 0.99 * expected


def focused(**lens) -> View:
    """Return a view that looks ahead from (0, 0, 3), with a lens."""
    return AHEAD.model_copy(update=lens)


LENS = focused(aperture=1.0, focus=3)


@pytest.mark.parametrize("depth", [2.0, 3.0, 4.5])
@pytest.mark.parametrize(("camera", "projector"), [(AHEAD, LENS), (LENS, AHEAD)])
def test_a_spot_is_blurred_by_a_disc_and_keeps_its_light(
    tmp_path: Path, camera: View, projector: View, depth: float
) -> None:
    plane = sheet((0, 0, 3 - depth), (3, 0, 0), (0, 3, 0), matt(0.5))
    size = (17, 17)
    blurred, sharp = (
        scene_of(tmp_path, world(plane, bounces=1), 16384, shape=size, cameras=[a], projectors=[b])
        for a, b in ((camera, projector), (AHEAD, AHEAD))
    )
    middle = np.zeros((1, *size))
    middle[0, 8, 8] = 1
    spot, expected = (
        scene.apply(middle.reshape(1, -1))[0, :, 1].reshape(size) for scene in (blurred, sharp)
    )
    assert np.flatnonzero(expected).tolist() == [8 * 17 + 8]
    assert spot.sum() == pytest.approx(expected.sum(), rel=0.02)
    rows, columns = np.indices(size) - 8
    diameter = abs(1 / depth - 1 / 3) / blurred.camera.pitch
    # the variance of a disc is diameter^2 / 16, of a pixel's width 1/12 on either side
    for offset in (rows, columns):
        variance = (spot * offset**2).sum() / spot.sum()
        assert variance == pytest.approx(diameter**2 / 16 + (1 / 6 if diameter else 0), rel=0.03)
    if diameter:
        away = np.hypot(rows, columns) - diameter / 2
        inside = spot[away < -np.sqrt(2)].mean()
        assert inside == pytest.approx(expected.sum() / (np.pi * diameter**2 / 4), rel=0.03)
        assert not spot[away > np.sqrt(2)].any()


ROOM = (*FLOOR_AND_WALL, ball((0, -0.4, 0), 0.5, matt(0.3)))
WIDE = IN_FRONT.model_copy(update={"aperture": 1.0, "focus": 2.5})


def test_equal_lenses_of_a_coaxial_rig_give_a_symmetric_transport(tmp_path: Path) -> None:
    behind_focus = sheet((0, 0, -1), (1, 0, 0), (0, 1, 0), LETTER)
    wide = focused(aperture=0.7, focus=3)
    for projector, is_symmetric in ((None, True), (AHEAD, False)):
        of = world(behind_focus, ROOM[2], camera=wide, projector=projector, bounces=2)
        scene = scene_of(tmp_path, of, 16384)
        traced = dense(scene._pieces, False, 1, (scene.camera.rays, scene.projector.rays))
        assert (differ(traced, traced.T) < 0.05) == is_symmetric == scene.coaxial


def test_a_camera_with_a_lens_equals_mitsubas(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, world(*ROOM, camera=WIDE, projector=BESIDE, bounces=3), 1024)
    picture, expected = half_lit(scene), rendered(scene, half_pattern(scene))
    noise = scene.recording.noise["half_lit"]["whole"]
    assert differ(picture, expected) < 3 * np.sqrt(2) * noise
    pinhole = scene_of(tmp_path, world(*ROOM, camera=IN_FRONT, projector=BESIDE, bounces=3), 1024)
    assert differ(picture, half_lit(pinhole)) > 0.05


def test_without_aperture_a_view_is_a_pinhole(tmp_path: Path) -> None:
    views = AHEAD, focused(aperture=0.0, focus=2)
    scenes = [scene_of(tmp_path, world(WALL, camera=view)) for view in views]
    assert scenes[0].describe() == scenes[1].describe()
    assert "lenses" not in scenes[0].describe()["camera"]
    # in focus at the target by default
    assert focused(aperture=0.1).lens == focused(aperture=0.1, focus=3).lens
