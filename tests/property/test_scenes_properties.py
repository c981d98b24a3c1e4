"""Scenes of any shape with any occluder: symmetry, compression, visibility of clusters."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from rfpipe.scenes import GEOMETRIES, Occluder, planes_scene, surface_points
from rfpipe.scenes.radiosity import FormFactors
from rfpipe.scenes.surfaces import MIXED, OCCLUDED, VISIBLE

shapes = st.tuples(st.integers(1, 12), st.integers(1, 12))


@st.composite
def occluders(draw):
    def vector(low, high):
        return tuple(draw(st.floats(low, high, width=16)) for _ in range(3))

    centre = np.array([0, 0, 2]) + vector(-1, 1)
    edge_u, edge_v = vector(-1, 1), vector(-1, 1)
    area = np.linalg.norm(np.cross(edge_u, edge_v))
    if area < 1e-3:
        edge_u, edge_v = (0, 0.5, 0), (0, 0, 0.5)
    return Occluder(tuple(centre), edge_u, edge_v)


@given(shapes, st.lists(occluders(), max_size=2), st.integers(0, 3))
def test_transport_is_symmetric_non_negative_and_applied_faithfully(shape, blockers, seed):
    scene = planes_scene("wedge", ("texture", "white"), shape, occluders=blockers, seed=seed)
    matrix = scene.dense(1)
    assert np.array_equal(matrix, matrix.T)
    assert (matrix >= 0).all()
    patterns = np.random.default_rng(seed).random((2, len(matrix)))
    expected = patterns @ matrix
    radiance = scene.apply(patterns)[..., 1]
    assert (np.abs(radiance - expected) <= 1e-5 * expected).all()


@settings(max_examples=25)
@given(
    st.sampled_from(["wedge", "wedge_30", "corner", "sphere_on_plane", "coloured_room"]),
    st.tuples(st.integers(1, 30), st.integers(1, 30)),
    st.lists(occluders(), max_size=2),
    st.integers(0, 100),
)
def test_compression_keeps_every_entry(geometry, shape, blockers, seed):
    points = surface_points(shape, GEOMETRIES[geometry])
    dense, packed = (FormFactors(points, blockers, compress=c) for c in (False, True))
    columns = np.random.default_rng(seed).random((len(points.surface), 4))
    columns[:, 0] = np.arange(len(columns)) == seed % len(columns)  # a column of G
    expected = dense.apply(columns)
    error = np.abs(packed.apply(columns) - expected)
    assert (error <= 5e-6 * expected + 1e-6 * expected.max(axis=0)).all()


@given(st.integers(0, 2**32 - 1))
def test_verdicts_on_clusters_hold_for_all_their_points(seed):
    random = np.random.default_rng(seed)
    centres = random.normal(0, (1.0, 0.7, 0.7), (2, 60, 1, 3))  # in the occluder's coordinates
    first, second = centres + random.normal(0, 0.2, (2, 60, 4, 3))
    square = Occluder((0, 0, 0), (1, 0, 0), (0, 1, 0))
    verdicts = square.classify(first, second)
    assert {OCCLUDED, VISIBLE, MIXED} == set(verdicts)
    weights = random.dirichlet(np.ones(4), (2, 60, 40))
    p, q = (np.einsum("npc,ncx->npx", w, c) for w, c in zip(weights, (first, second), strict=True))
    result = square.blocks(p[:, :, None], q[:, None]).mean((1, 2))
    assert (result[verdicts == VISIBLE] == 0).all()
    assert (result[verdicts == OCCLUDED] == 1).all()
