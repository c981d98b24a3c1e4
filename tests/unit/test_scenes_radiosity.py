"""The transport of radiosity scenes: symmetry, energy, occluders, compression, determinism."""

import json
import subprocess
import sys

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.scenes import (
    GEOMETRIES,
    REFERENCE_SCENES,
    Occluder,
    RadiosityScene,
    compression,
    planes_scene,
    reference_scene,
    scene_from_config,
    surface_points,
)
from rfpipe.scenes.clusters import ClusterTree, cluster_pairs
from rfpipe.scenes.facing import facing_pairs
from rfpipe.scenes.formfactors import form_factors
from rfpipe.scenes.hard import PLATE

TILTED = Occluder((0.2, 0.1, 1.5), (0.2, 0, 0.1), (0, 0.15, 0.05))  # seen by the camera


def random_patterns(count, rays, seed=0):
    return np.random.default_rng(seed).random((count, rays)).astype(np.float32)


def textured(shape=(12, 14), **settings):
    return planes_scene("wedge", ("texture", "texture"), shape, **settings)


@pytest.mark.parametrize("name", REFERENCE_SCENES)
@pytest.mark.parametrize("shape", [(16, 16), (9, 13)])
def test_reference_scenes_are_symmetric_and_apply_is_their_matrix(name, shape):
    scene = reference_scene(name, shape)
    patterns = random_patterns(5, shape[0] * shape[1])
    radiance = scene.apply(patterns)
    assert radiance.shape == (5, shape[0] * shape[1], 3)
    assert radiance.dtype == np.float32
    for channel in range(3):
        matrix = scene.dense(channel)
        assert np.array_equal(matrix, matrix.T)
        assert (matrix >= 0).all()
        assert radiance[..., channel] == pytest.approx(patterns @ matrix, rel=1e-5)


def test_matrix_follows_the_formulas_entry_by_entry():
    scene = textured((4, 6), channels=1)
    points, albedo = scene.points, scene.albedo.reshape(-1).astype(np.float64)
    normals = np.stack([plane.unit_normal for plane in points.planes])[points.surface]
    rays, mean = len(albedo), points.areas.mean()
    geometry = np.zeros((rays, rays))
    for i in range(rays):
        for j in range(rays):
            if points.surface[i] != points.surface[j]:
                to = points.positions[j] - points.positions[i]
                squared = max(to @ to, mean)
                cosines = max(to @ normals[i], 0) * max(-to @ normals[j], 0) / squared
                geometry[i, j] = cosines / (np.pi * squared)
    reflect = np.diag(albedo)
    expected = np.diag(albedo / points.areas) + reflect @ geometry @ reflect
    expected += reflect @ geometry @ np.diag(albedo * points.areas) @ geometry @ reflect
    assert scene.dense() == pytest.approx(mean * expected, rel=1e-6, abs=1e-12)


def test_scene_i_has_direct_light_alone():
    matrix = reference_scene("I", (12, 12)).dense(2)
    assert np.array_equal(matrix, np.diag(np.diag(matrix)))
    assert (np.diag(matrix) > 0).all()


def test_bounces_add_light_where_they_should():
    shape = (10, 12)
    direct, second, third, fourth = (textured(shape, bounces=n).dense(0) for n in (1, 2, 3, 4))
    left = textured(shape).points.surface == 0
    between, within = np.ix_(left, ~left), np.ix_(left, left)
    assert np.array_equal(direct, np.diag(np.diag(direct)))
    assert (second[between] > 0).all()
    assert np.array_equal(second[within], direct[within])
    assert (third[within] > direct[within]).all()
    assert third[between] == pytest.approx(second[between], rel=1e-12)
    assert (fourth[between] > third[between]).all()
    patterns = random_patterns(2, 120)
    for bounces, matrix in enumerate((direct, second, third, fourth), start=1):
        radiance = textured(shape, bounces=bounces).apply(patterns)[..., 0]
        assert radiance == pytest.approx(patterns @ matrix, rel=1e-5)


def lambert(point, normal, polygon):
    """Form factor from a surface element to a polygon [Lambert 1760], in closed form."""
    rays = (polygon - point) / np.linalg.norm(polygon - point, axis=1)[:, None]
    following = np.roll(rays, -1, axis=0)
    normals = np.cross(rays, following)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    angles = np.arccos(np.clip((rays * following).sum(1), -1, 1))
    return abs((angles * (normals @ normal)).sum()) / (2 * np.pi)


def test_form_factors_add_up_to_lamberts_closed_form():
    points = surface_points((60, 70), GEOMETRIES["wedge"])
    (pair,) = facing_pairs(points)
    received = pair.block() @ points.areas[pair.indices[1]]
    end = 70 / 60 / 2
    near = 3 / (1 + end)
    right = np.array(
        [[0, -1.5, 3], [end * near, -near / 2, near], [end * near, near / 2, near], [0, 1.5, 3]]
    )
    pixels = np.arange(4200).reshape(60, 70)
    for row, column in ((30, 2), (30, 15), (5, 20), (55, 25), (0, 0)):
        i = pixels[row, column]
        expected = lambert(points.positions[i], points.planes[0].unit_normal, right)
        found = received[np.flatnonzero(pair.indices[0] == i)[0]]
        assert found == pytest.approx(expected, rel=3e-3)


def test_indirect_light_brightens_towards_the_edge_and_fades_in_it():
    floodlit = np.ones((1, 60 * 70))
    images = [
        planes_scene("wedge", ("white", "white"), (60, 70), channels=1, bounces=n).apply(floodlit)
        for n in (1, 3)
    ]
    indirect = (images[1] / images[0] - 1).reshape(60, 70)[30]  # per direct light
    assert (np.diff(indirect[:28]) > 0).all()
    assert indirect[:35] == pytest.approx(indirect[:34:-1], rel=1e-5)
    assert indirect.max() < 0.8  # no more than albedo times the whole hemisphere


def test_occluder_blocks_exactly_the_pairs_behind_it_and_raises_the_rank():
    free, plated = (textured((16, 16), channels=1, bounces=2, occluders=o) for o in ((), (PLATE,)))
    points = free.points
    left = points.surface == 0
    before, after = (scene.dense()[np.ix_(left, ~left)] for scene in (free, plated))
    start, stop = points.positions[left], points.positions[~left]
    fraction = start[:, None, 0] / (start[:, None, 0] - stop[None, :, 0])  # crosses x = 0
    crossing = start[:, None] + fraction[..., None] * (stop[None] - start[:, None])
    hidden = (np.abs(crossing[..., 1]) <= 0.5) & (np.abs(crossing[..., 2] - 2.6) <= 0.25)
    assert 0.1 < hidden.mean() < 0.9
    assert (after[hidden] == 0).all()
    assert np.array_equal(after[~hidden], before[~hidden])

    # Away from the edge the planes see each other smoothly: the blocks there tell the difference.
    far = np.ix_(start[:, 0] < -0.5, stop[:, 0] > 0.5)
    ranks = [
        int((values > 1e-3 * values[0]).sum())
        for values in (np.linalg.svd(block[far], compute_uv=False) for block in (before, after))
    ]
    assert ranks[0] < 16
    assert ranks[1] > 2 * ranks[0]


def test_plate_seen_edge_on_hides_no_pixel():
    assert np.array_equal(textured(occluders=(PLATE,)).albedo, textured().albedo)


def test_occluder_in_view_is_black():
    scene = textured((20, 22), occluders=(TILTED,))
    x, y, z = TILTED.centre
    row, column = int((y / z + 0.5) * 20), int(x / z * 20 + 11)
    assert (scene.albedo[row, column] == 0).all()
    seen = (scene.albedo == 0).all(-1)
    assert 0.01 < seen.mean() < 0.2
    matrix = scene.dense(0)
    assert not matrix[seen.ravel()].any()
    assert not matrix[:, seen.ravel()].any()
    assert np.array_equal(matrix, matrix.T)


@pytest.mark.parametrize("occluders", [(), (PLATE,), (PLATE, TILTED)])
def test_compressed_form_factors_are_the_dense_ones(occluders):
    points = surface_points((37, 41), GEOMETRIES["wedge"])
    dense, packed = (form_factors(points, occluders, compress=c) for c in (False, True))
    assert all(isinstance(block, compression.CompressedBlock) for block in packed.blocks)
    columns = np.random.default_rng(0).random((37 * 41, 3))
    columns[:, 1] = 0
    columns[100:104, 1] = 1  # light from a spot alone
    expected = dense.apply(columns)
    error = np.abs(packed.apply(columns) - expected)
    assert (error <= 5e-6 * expected + 1e-9 * expected.max(axis=0)).all()
    assert packed.nbytes < dense.nbytes


def test_clusters_partition_the_pairs_that_are_not_hidden():
    points = surface_points((40, 44), GEOMETRIES["wedge"])
    (pair,) = facing_pairs(points, (PLATE,))
    trees = tuple(
        ClusterTree.of_surface(surface, positions, 8)
        for surface, positions in zip(pair.surfaces, pair.positions, strict=True)
    )
    found = cluster_pairs(trees, (PLATE,), separation=0.5, least_distance=0.1, depth=2)
    covered = np.zeros((len(pair.indices[0]), len(pair.indices[1])), dtype=int)
    smooth = covered.copy()
    for a, b, far in zip(found.first, found.second, found.smooth, strict=True):
        part = np.ix_(
            trees[0].order[trees[0].start[a] : trees[0].stop[a]],
            trees[1].order[trees[1].start[b] : trees[1].stop[b]],
        )
        covered[part] += 1
        smooth[part] += far
    visible = pair.block() > 0
    assert (covered[visible] == 1).all()
    assert covered.max() == 1
    assert (covered == 0).sum() > 0.5 * (~visible).sum()  # most of the hidden pairs are dropped
    assert visible[smooth == 1].all()
    assert smooth.sum() > 0.5 * visible.sum()


def test_compressed_scene_agrees_with_its_matrix():
    scene = textured((30, 33), occluders=(PLATE,), compress=True)
    patterns = random_patterns(3, 990) < 0.1
    radiance = scene.apply(patterns)
    (block,) = scene._surfaces.form_factors.blocks
    assert isinstance(block, compression.CompressedBlock)
    for channel in range(3):
        assert radiance[..., channel] == pytest.approx(patterns @ scene.dense(channel), rel=1e-5)


def test_a_pattern_gives_the_same_bits_in_any_company():
    for compress in (False, True):
        scene = textured((21, 23), compress=compress)
        patterns = random_patterns(35, 21 * 23)
        together = scene.apply(patterns)
        order = np.random.default_rng(1).permutation(35)
        assert np.array_equal(scene.apply(patterns[order]), together[order])
        for index in (0, 7, 34):
            assert np.array_equal(scene.apply(patterns[index : index + 1])[0], together[index])


def test_compressed_sums_do_not_depend_on_the_number_of_threads(monkeypatch):
    results = []
    for threads in (1, 3):
        monkeypatch.setattr(compression, "_threads", lambda threads=threads: threads)
        results.append(textured((40, 44), compress=True).apply(random_patterns(4, 1760)))
    assert np.array_equal(*results)


def test_small_scenes_need_neither_numba_nor_scipy():
    code = (
        "import sys, numpy\n"
        "from rfpipe.scenes import reference_scene\n"
        "reference_scene('IV', (12, 14)).apply(numpy.ones((1, 168)))\n"
        "sys.exit(bool({'numba', 'scipy', 'pydantic'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_patterns_may_be_images():
    scene = textured()
    patterns = random_patterns(2, 168)
    assert np.array_equal(scene.apply(patterns.reshape(2, 12, 14)), scene.apply(patterns))


@pytest.mark.parametrize("shape", [(168,), (2, 167), (2, 14, 12), (1, 2, 12, 14)])
def test_patterns_of_another_shape_are_refused(shape):
    with pytest.raises(InputError, match=r"expected \(patterns, 168\)"):
        textured().apply(np.zeros(shape))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_patterns_that_are_not_finite_are_refused(value):
    patterns = np.zeros((2, 168))
    patterns[1, 5] = value
    with pytest.raises(InputError, match="NaN or infinity"):
        textured().apply(patterns)


def test_dense_is_refused_where_it_would_not_fit():
    scene = textured((91, 91))
    with pytest.raises(InputError, match=r"8281 rays .* apply"):
        scene.dense()
    with pytest.raises(InputError, match="channel 3"):
        textured().dense(3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"geometry": "sphere"}, "sphere.*plane, wedge"),
        ({"surfaces": ("white",)}, "expected 2"),
        ({"surfaces": ("white", "mirror")}, "'white' or 'texture'"),
        ({"channels": 2}, "channels 2"),
        ({"bounces": 0}, "bounces 0"),
    ],
)
def test_settings_out_of_range_are_refused(settings, message):
    usual = {"geometry": "wedge", "surfaces": ("white", "white"), "shape": (4, 4)}
    with pytest.raises(InputError, match=message):
        planes_scene(**(usual | settings))


def test_albedo_out_of_range_is_refused():
    points = surface_points((4, 5), GEOMETRIES["plane"])
    with pytest.raises(InputError, match="below 1"):
        RadiosityScene(points, np.ones((4, 5, 1)))
    with pytest.raises(InputError, match=r"\(4, 5, channels\)"):
        RadiosityScene(points, np.ones((4, 5)))
    with pytest.raises(InputError, match=r"'V'.*I, II, III, IV"):
        reference_scene("V", (4, 4))


def test_config_describes_the_same_scene():
    config = SceneSettings.of(
        "wedge",
        surfaces=("white", "texture"),
        shape=(12, 14),
        channels=1,
        bounces=2,
        occluders=[{"centre": PLATE.centre, "edge_u": PLATE.edge_u, "edge_v": PLATE.edge_v}],
        seed=5,
    )
    made = scene_from_config(config)
    direct = planes_scene(
        "wedge", ("white", "texture"), (12, 14), channels=1, bounces=2, occluders=[PLATE], seed=5
    )
    assert made.describe() == direct.describe()
    assert np.array_equal(made.dense(), direct.dense())


def test_descriptions_are_plain_and_tell_scenes_apart():
    variants = [
        textured(),
        textured(seed=1),
        textured(bounces=2),
        textured(channels=1),
        textured((12, 15)),
        textured(occluders=(PLATE,)),
        textured(compress=True),
        reference_scene("II", (12, 14)),
    ]
    prints = {fingerprint(scene.describe()) for scene in variants}
    assert len(prints) == len(variants)
    assert fingerprint(textured().describe()) in prints
    assert json.loads(json.dumps(textured(occluders=(PLATE,)).describe()))["bounces"] == 3
