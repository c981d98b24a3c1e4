"""The multilevel transport as a linear operator, by dual photography of random matrices."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.rigs.known_matrix import acquire_matrix, dense

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.dual import Dual
from rfpipe.transport.multilevel import MultilevelTransport

shapes = st.one_of(
    st.tuples(st.integers(1, 9), st.integers(1, 9)),
    st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 5)),
)


@st.composite
def rigs(draw: st.DrawFn) -> tuple[np.ndarray, tuple[int, ...], tuple[int, ...], float]:
    """Draw a matrix (C, M, N) that isn't zero, both ray domains and a tolerance."""
    camera, projector = draw(shapes), draw(shapes)
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    shape = (draw(st.sampled_from([1, 3])), RayDomain(camera).size, RayDomain(projector).size)
    share = draw(st.sampled_from([0.02, 0.3, 1.0]))
    matrix = random.random(shape) * (random.random(shape) < share)
    return matrix, camera, projector, draw(st.sampled_from([1e-6, 1e-2, 0.3]))


@st.composite
def transports(draw: st.DrawFn) -> MultilevelTransport:
    matrix, camera, projector, tolerance = draw(rigs())
    if camera == projector and draw(st.booleans()):
        matrix = matrix + matrix.transpose(0, 2, 1)
    run = acquire_matrix(Dual(), matrix, camera, projector, tolerance)
    assert isinstance(run.transport, MultilevelTransport)
    return run.transport


def by_definition(transport: MultilevelTransport) -> np.ndarray:
    """Return the matrices of eq. (3.2): each value is spread over the rays of its block.

    In a symmetric transport, the value of a pixel is spread in proportion to the light that the
    pixels of these rays receive from the pixel's block of the same level.
    """
    even = evenly(transport)
    if not transport.symmetric:
        return even
    tree = transport.tree
    matrix = np.zeros_like(even)
    for pairs in transport.level_responses:
        starts, block_of_ray = tree.starts[pairs.level], tree.labels(pairs.level).ravel()
        for n, (block, pixel) in enumerate(zip(pairs.block, pairs.pixel, strict=True)):
            rays = tree.order[starts[block] : starts[block + 1]]
            around = tree.order[starts[block_of_ray[pixel]] : starts[block_of_ray[pixel] + 1]]
            received = even[:, rays][:, :, around].sum(axis=2)
            total = received.sum(axis=1, keepdims=True)
            share = np.where(total > 0, received / np.where(total > 0, total, 1), 1 / len(rays))
            matrix[:, pixel, rays] += pairs.values[:, n, None].astype(np.float64) * share
    return matrix


def evenly(transport: MultilevelTransport) -> np.ndarray:
    tree = BlockTree(RayDomain(transport.projector_shape))
    pixels = RayDomain(transport.camera_shape).size
    matrix = np.zeros((transport.channels, pixels, tree.domain.size))
    for pairs in transport.level_responses:
        for n, (block, pixel) in enumerate(zip(pairs.block, pairs.pixel, strict=True)):
            start, end = tree.starts[pairs.level][block : block + 2]
            share = pairs.values[:, n, None].astype(np.float64) / (end - start)
            matrix[:, pixel, tree.order[start:end]] += share
    return matrix


@settings(max_examples=25)
@given(transports())
def test_equals_the_dense_matrix(transport: MultilevelTransport) -> None:
    matrix = by_definition(transport)
    scale = max(matrix.max(), 1e-30)
    np.testing.assert_allclose(dense(transport), matrix, rtol=0, atol=1e-6 * scale)
    for channel in range(transport.channels):
        operator = transport.channel(channel)
        transposed = operator.T @ np.eye(operator.shape[0], dtype=np.float32)
        np.testing.assert_allclose(transposed, matrix[channel].T, rtol=0, atol=1e-6 * scale)


@settings(max_examples=25)
@given(transports(), st.data())
def test_truncation_keeps_the_energy(transport: MultilevelTransport, data: st.DataObject) -> None:
    level = data.draw(st.integers(0, transport.tree.n_levels - 1))
    truncated = transport.truncate(level)
    assert all(pairs.level <= level for pairs in truncated.level_responses)
    light = np.ones(transport.projector_shape)
    np.testing.assert_allclose(
        truncated.relight(light), transport.relight(light), rtol=1e-5, atol=1e-7
    )
    # the rays of a block get its mean light
    even = np.random.default_rng(0).random(transport.tree.n_blocks(level))
    pattern = even[transport.tree.labels(level)]
    np.testing.assert_allclose(
        truncated.relight(pattern), transport.relight(pattern), rtol=1e-5, atol=1e-7
    )


@settings(max_examples=25)
@given(rigs())
def test_fine_tolerance_recovers_the_matrix(
    rig: tuple[np.ndarray, tuple[int, ...], tuple[int, ...], float],
) -> None:
    matrix, camera, projector, _ = rig
    run = acquire_matrix(Dual(), matrix, camera, projector, tolerance=1e-7)
    np.testing.assert_allclose(dense(run.transport), matrix, rtol=1e-4, atol=1e-5)
