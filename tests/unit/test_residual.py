"""What a model leaves, from all pictures: wavelets, the most probable exchange, and its bounds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.rigs.known_matrix import scene_matrices

from rfpipe.methods.residual.model import Canvas, Sender, residual_of, root_of
from rfpipe.methods.residual.posterior import Posterior
from rfpipe.provenance import generator
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.wavelet import Cells, Haar, cell_side

STACKS = st.tuples(st.integers(1, 3), st.integers(1, 27), st.integers(1, 27))


# --- wavelets and cells


@given(STACKS, st.integers(0, 2**31))
def test_the_transform_is_orthonormal(stack: tuple[int, int, int], seed: int) -> None:
    haar, random = Haar(stack), np.random.default_rng(seed)
    images = random.standard_normal((int(np.prod(stack)), 3)).astype(np.float32)
    found = haar.forward(images)
    np.testing.assert_allclose(haar.inverse(found), images, atol=2e-6)
    other = random.standard_normal(found.shape).astype(np.float32)
    # the inverse is the transpose
    assert np.vdot(found, other) == pytest.approx(np.vdot(images, haar.inverse(other)), abs=2e-3)
    numbers = np.concatenate([rows for group in haar.groups for rows in group.alike()])
    assert sorted(numbers) == list(range(haar.size))


@pytest.mark.parametrize(
    ("shape", "most", "side"),
    [((48, 48), 4096, 1), ((65, 64), 4096, 2), ((310, 350), 4096, 6), ((9, 8, 8), 100, 3),
     ((9, 8, 8), 5, 8), ((1, 1), 1, 1)],
)  # fmt: skip
def test_cells_are_as_small_as_they_may_be(shape: tuple[int, ...], most: int, side: int) -> None:
    assert cell_side(shape, most) == side
    cells = Cells(shape, side)
    assert cells.count == len(np.unique(cells.of_ray))
    images = np.random.default_rng(0).random((3, len(cells.of_ray))).astype(np.float32)
    totals = cells.total(images)
    for cell in {0, cells.count // 2, cells.count - 1}:
        np.testing.assert_allclose(totals[cell], images[:, cells.of_ray == cell].sum(axis=1), 1e-5)
    np.testing.assert_array_equal(cells.spread(totals)[1], totals[cells.of_ray, 1])


# --- the fit


def posterior_of(
    haar: Haar, matrix: np.ndarray, count: int, deviation: float
) -> tuple[Posterior, np.ndarray]:
    """Return the posterior of pictures, and the pictures."""
    random = generator(0, 7)
    light = (random.random((len(matrix), count)) < 0.4).astype(np.float32)
    seen = (matrix @ light + deviation * random.standard_normal(light.shape)).astype(np.float32)
    spread = np.full(light.shape, deviation**2, np.float32)
    return Posterior(haar, light, seen, spread), seen


def symmetric_matrix(haar: Haar, prior: np.ndarray) -> np.ndarray:
    """A matrix of cells that is as likely as the prior says."""
    core = np.triu(generator(0, 8).standard_normal(prior.shape) * np.sqrt(prior))
    core = core + np.triu(core, 1).T
    return haar.inverse(haar.inverse(core.astype(np.float32)).T.copy()).astype(np.float64)


def test_the_solution_is_the_mean_of_the_posterior() -> None:
    """Against all entries at once, by dense algebra."""
    haar = Haar((1, 6, 6))
    prior = posterior_of(haar, np.eye(36), 5, 0.01)[0].guessed()
    prior /= prior.sum()
    matrix = symmetric_matrix(haar, prior)
    posterior, seen = posterior_of(haar, matrix, 5, 0.01)
    posterior.prepare(prior)
    posterior.solve(posterior.observed, 300)
    size, count = haar.size, 5
    first, second = np.triu_indices(size)
    told = np.zeros((size, count, len(first)))
    light = posterior.light
    pair = np.arange(len(first))
    for picture in range(count):
        told[first, picture, pair] += light[second, picture]
        off = first != second
        told[second[off], picture, pair[off]] += light[first[off], picture]
    seen = haar.forward(seen)
    # the direct light of each cell is unknown, too
    cells = np.eye(size, dtype=np.float32)[:, None] * posterior.cells[:, :, None]
    direct = np.stack([haar.forward(np.ascontiguousarray(cells[..., k])) for k in range(size)], -1)
    told = np.concatenate([told, direct], axis=2).reshape(size * count, -1)
    # in units of the prior's deviation; off the diagonal, an entry is there twice
    variance = np.concatenate([np.where(first == second, 2, 1) * prior[first, second],
                               np.full(size, posterior._direct)])  # fmt: skip
    covariance = (told * variance) @ told.T + 0.01**2 * np.eye(size * count)
    expected = variance * (told.T @ np.linalg.solve(covariance, seen.reshape(-1)))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(
        posterior.core[first, second], expected[: len(first)], atol=2e-3 * scale
    )
    np.testing.assert_allclose(posterior.direct, expected[len(first) :], atol=2e-3 * scale)


# --- the estimate


def pictures_of(matrix: np.ndarray, canvas: Canvas, count: int, known: np.ndarray):
    """All-on and random pictures of a matrix (C, N, N), exact."""
    random = generator(0, 9)
    rays = matrix.shape[1]
    cells = random.random((count, canvas.cells.count)) < 0.3
    lit = np.concatenate([np.ones((1, rays), bool), cells[:, canvas.cells.of_ray]])
    images = np.einsum("cij,mj->mci", matrix, lit).astype(np.float32)
    variance = np.where(known, np.float32(1e-10), np.float32(np.inf))
    return canvas.taken(lit, np.where(known, images, 0), np.broadcast_to(variance, images.shape))


@pytest.mark.parametrize(
    ("side", "unknown", "aside"), [(1, 0, False), (1, 20, False), (2, 0, False), (1, 0, True)]
)
def test_it_finds_what_a_model_leaves_and_no_darkness_below_nought(
    side: int, unknown: int, aside: bool
) -> None:
    """Of a wedge, from a model that knows the direct light alone; in cells, one without texture.

    From aside, by a camera that hangs upside down.
    """
    shape, channels = (16, 16), 3
    matrix = scene_matrices("IV" if side == 1 else "II", shape, channels)
    known = np.ones(256, np.bool_)
    known[generator(0, 4).permutation(256)[:unknown]] = False
    direct = np.einsum("cii->ci", matrix)[..., None] * np.eye(256)
    cells, sender = Cells(shape, side), None
    if aside:
        matrix, direct = matrix[:, ::-1], direct[:, ::-1]
        places = np.indices(shape).reshape(2, -1)[:, ::-1].T.astype(np.float32)
        sender = Sender(cells, root_of(matrix.sum(axis=1).astype(np.float32)), places)
    floodlit = matrix.sum(axis=2).astype(np.float32)
    canvas = Canvas(cells, floodlit, known)
    model = DenseTransport(shape, shape, channels, [], {"matrix": direct.astype(np.float32)})
    found = residual_of(canvas, pictures_of(matrix, canvas, 60, known), model, sender)
    left = found.transport(canvas, shape)
    patterns = generator(0, 3).random((2, channels, 256)).astype(np.float32)
    np.testing.assert_allclose(
        np.vdot(left.forward(patterns, range(channels))[0], patterns[1]),
        np.vdot(patterns[0], left.adjoint(patterns, range(channels))[1]), rtol=1e-3,
    )  # fmt: skip
    for channel in range(channels):
        cell = canvas.cells.of_ray
        off = (cell[:, None] != cell) & known[:, None] & known
        if aside:
            off = off[::-1]
        truth = np.where(off, matrix[channel], 0)
        relit = np.where(off, left.channel(channel) @ np.eye(256), 0)
        lit = generator(0, 5).random((canvas.cells.count, 8)) < 0.5
        pictures = lit[canvas.cells.of_ray].astype(float)
        relit_cells, true_cells = (
            canvas.cells.total((each @ pictures).T) for each in (relit, truth)
        )
        wrong = np.linalg.norm(relit_cells - true_cells) / np.linalg.norm(true_cells)
        # without symmetry, pictures tell half as much
        assert wrong < (0.25 if aside else 0.12)
        assert relit.min() > -0.02 * truth.max()
