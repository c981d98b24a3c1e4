"""The residual model: wavelets, cells, the most probable exchange, and the fit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.rigs.known_matrix import scene_matrices

from rfpipe.methods.residual.cell_data import CellData, cell_data
from rfpipe.methods.residual.fit import fit_residual
from rfpipe.methods.residual.model import (
    CameraCells,
    CellPictures,
    ProjectorCells,
    Residual,
    coaxial_projector,
    root_factor,
)
from rfpipe.methods.residual.pair_kernels import extrapolate
from rfpipe.methods.residual.posterior import DenseExchange, PairExchange, Posterior
from rfpipe.methods.residual.prior import initial_prior, learn_prior, threshold_below
from rfpipe.provenance import generator
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.wavelet import Cells, Haar, cell_side

STACKS = st.tuples(st.integers(1, 3), st.integers(1, 27), st.integers(1, 27))


# --- wavelets and cells


@given(STACKS, st.integers(0, 2**31))
def test_the_haar_transform_is_orthonormal(stack: tuple[int, int, int], seed: int) -> None:
    haar, random = Haar(stack), np.random.default_rng(seed)
    images = random.standard_normal((int(np.prod(stack)), 3)).astype(np.float32)
    transformed = haar.forward(images)
    np.testing.assert_allclose(haar.inverse(transformed), images, atol=2e-6)
    # the inverse is the transpose
    dual = random.standard_normal(transformed.shape).astype(np.float32)
    assert np.vdot(transformed, dual) == pytest.approx(
        np.vdot(images, haar.inverse(dual)), abs=2e-3
    )
    numbers = np.concatenate([rows for group in haar.groups for rows in group.by_place()])
    assert sorted(numbers) == list(range(haar.size))


@pytest.mark.parametrize(
    ("shape", "largest_count", "side"),
    [((48, 48), 4096, 1), ((65, 64), 4096, 2), ((310, 350), 4096, 6), ((9, 8, 8), 100, 3),
     ((9, 8, 8), 5, 8), ((1, 1), 1, 1)],
)  # fmt: skip
def test_cells_are_as_small_as_their_largest_number_allows(
    shape: tuple[int, ...], largest_count: int, side: int
) -> None:
    assert cell_side(shape, largest_count) == side
    cells = Cells(shape, side)
    assert cells.count == len(np.unique(cells.of_ray))
    images = np.random.default_rng(0).random((3, len(cells.of_ray))).astype(np.float32)
    totals = cells.total(images)
    for cell in {0, cells.count // 2, cells.count - 1}:
        np.testing.assert_allclose(totals[cell], images[:, cells.of_ray == cell].sum(axis=1), 1e-5)
    factor = images[0]
    np.testing.assert_allclose(
        cells.total_of_products(images, factor), cells.total(images * factor), rtol=1e-5
    )
    np.testing.assert_array_equal(cells.spread(totals, factor)[1], totals[cells.of_ray, 1] * factor)


# --- the posterior


def noisy_pictures(haar: Haar, matrix: np.ndarray, count: int, deviation: float) -> CellData:
    """Return noisy pictures of random patterns of cells, under a matrix of cells."""
    random = generator(0, 7)
    light = (random.random((len(matrix), count)) < 0.4).astype(np.float32)
    noise = deviation * random.standard_normal(light.shape)
    variance = np.full(light.shape, deviation**2, np.float32)
    return cell_data(haar, light, (matrix @ light + noise).astype(np.float32), variance)


def random_matrix(haar: Haar, prior: np.ndarray) -> np.ndarray:
    """Draw a symmetric matrix of cells from the prior."""
    core = np.triu(generator(0, 8).standard_normal(prior.shape) * np.sqrt(prior))
    core = core + np.triu(core, 1).T
    return haar.inverse_both(core.astype(np.float32), haar).astype(np.float64)


def design_matrix(data: CellData) -> np.ndarray:
    """Return the pictures, in wavelets, of each entry of C on and above the diagonal and of d."""
    size, count = data.haar.size, data.light.shape[1]
    first, second = np.triu_indices(size)
    design = np.zeros((size, count, len(first)))
    pair, off_diagonal = np.arange(len(first)), first != second
    for picture in range(count):
        light = data.light[:, picture]
        design[first, picture, pair] += light[second]
        design[second[off_diagonal], picture, pair[off_diagonal]] += light[first[off_diagonal]]
    cells = np.eye(size, dtype=np.float32)[:, None] * data.cell_light[:, :, None]
    direct = [data.haar.forward(np.ascontiguousarray(cells[..., k])) for k in range(size)]
    return np.concatenate([design, np.stack(direct, -1)], axis=2).reshape(size * count, -1)


@pytest.mark.parametrize("by_pairs", [False, True])
def test_the_solution_is_the_mean_of_the_posterior(by_pairs: bool) -> None:
    """Compared with dense algebra over all entries; a third of the pairs exchange no light."""
    haar, deviation = Haar((1, 6, 6)), 0.01
    prior = initial_prior(noisy_pictures(haar, np.eye(36), 5, deviation))
    prior /= prior.sum()
    if by_pairs:
        exchanges = np.triu(generator(0, 6).random(prior.shape) < 2 / 3)
        prior *= exchanges | exchanges.T
    data = noisy_pictures(haar, random_matrix(haar, prior), 5, deviation)

    exchange = PairExchange.of(data, prior) if by_pairs else DenseExchange(prior, data.light, True)
    solution = Posterior.of(data, prior, exchange).solve(data.observed, 300)
    core = solution.core.T
    if isinstance(exchange, PairExchange):
        core = np.zeros_like(prior)
        core[exchange.pairs.first, exchange.pairs.second] = solution.core

    design = design_matrix(data)
    first, second = np.triu_indices(haar.size)
    # an entry on the diagonal is the sum of two halves
    entry_variance = np.where(first == second, 2, 1) * prior[first, second]
    variance = np.concatenate([entry_variance, np.full(haar.size, data.direct_variance)])
    covariance = (design * variance) @ design.T + deviation**2 * np.eye(len(design))
    pictures = haar.forward(data.observed).reshape(-1)
    expected = variance * (design.T @ np.linalg.solve(covariance, pictures))
    scale = np.abs(expected).max()
    np.testing.assert_allclose(core[first, second], expected[: len(first)], atol=2e-3 * scale)
    np.testing.assert_allclose(solution.direct, expected[len(first) :], atol=2e-3 * scale)


@given(STACKS, STACKS, st.integers(0, 2**31))
def test_both_sides_of_a_matrix_are_transformed(
    stack: tuple[int, int, int], columns: tuple[int, int, int], seed: int
) -> None:
    haar, sender_haar = Haar(stack), Haar(columns)
    size = int(np.prod(stack)), int(np.prod(columns))
    matrix = np.random.default_rng(seed).standard_normal(size).astype(np.float32)
    core = haar.forward_both(matrix, sender_haar)
    W, W_sender = (
        h.forward(np.eye(n, dtype=np.float32))
        for h, n in zip((haar, sender_haar), size, strict=True)
    )
    np.testing.assert_allclose(core, W @ matrix @ W_sender.T, atol=2e-4)
    np.testing.assert_allclose(haar.inverse_both(core, sender_haar), matrix, atol=2e-5)


def test_the_prior_keeps_nearly_all_of_the_expected_light() -> None:
    haar = Haar((1, 24, 24))
    falloff = 1 / (1 + np.square(np.arange(576)[:, None] - np.arange(576)))
    data = noisy_pictures(haar, falloff, 12, 0.01)
    prior = learn_prior(data)
    assert 0.002 < np.mean(prior > 0) < 0.5
    np.testing.assert_array_equal(prior, prior.T)


@given(
    st.lists(st.floats(0, 1e6, width=32, allow_subnormal=False), min_size=1, max_size=50),
    st.floats(0, 1),
)
def test_values_below_the_threshold_add_up_to_at_most_the_total(
    values: list[float], share: float
) -> None:
    array = np.array(values, np.float32)
    total = share * float(array.sum(dtype=np.float64))
    threshold = threshold_below(array, total)
    below = array[array < threshold]
    assert below.sum(dtype=np.float64) <= total
    # the next class, of values that differ by 1 %, would exceed it
    following = array[array < 1.02 * threshold]
    assert len(following) == len(array) or following.sum(dtype=np.float64) > total


def test_extrapolation_respects_the_least_light_except_on_the_diagonal() -> None:
    matrix = np.array([[-3.0, 1.0], [-1.0, -3.0]], np.float32)
    previous, least = np.zeros_like(matrix), np.full_like(matrix, -2)
    extrapolate(matrix, previous, 1.5, least, True)
    np.testing.assert_array_equal(matrix, [[-7.5, 2.5], [-2, -7.5]])
    np.testing.assert_array_equal(previous, [[-3, 1], [-1, -3]])
    extrapolate(matrix, previous, 0.0, least, False)
    np.testing.assert_array_equal(matrix, [[-2, 2.5], [-2, -2]])


# --- the fit


def exact_pictures(
    matrix: np.ndarray, camera: CameraCells, count: int, known: np.ndarray
) -> CellPictures:
    """Return exact pictures of a matrix (C, N, N), of white light and of random cells."""
    random = generator(0, 9)
    rays = matrix.shape[1]
    cells = random.random((count, camera.cells.count)) < 0.3
    lit = np.concatenate([np.ones((1, rays), bool), cells[:, camera.cells.of_ray]])
    images = np.einsum("cij,mj->mci", matrix, lit).astype(np.float32)
    variance = np.where(known, np.float32(1e-10), np.float32(np.inf))
    return camera.cell_pictures(
        lit, np.where(known, images, 0), np.broadcast_to(variance, images.shape)
    )


@pytest.mark.parametrize(
    ("side", "unknown_pixels", "coaxial", "pictures_before"),
    [(1, 0, True, 0), (1, 20, True, 0), (2, 0, True, 0), (1, 0, False, 0), (1, 0, True, 40),
     (1, 0, False, 40)],
)  # fmt: skip
def test_the_fit_explains_light_missing_in_a_model_of_direct_light(
    side: int, unknown_pixels: int, coaxial: bool, pictures_before: int
) -> None:
    """The fit may start from a fit to fewer pictures, in half as many steps.

    The scene is a wedge with texture; in cells of 2 x 2 pixels, without texture.

    The camera of the rig that isn't coaxial is upside down. Without the symmetry, pictures
    determine the residual half as well.
    """
    shape, channels = (16, 16), 3
    matrix = scene_matrices("IV" if side == 1 else "II", shape, channels)
    known = np.ones(256, np.bool_)
    known[generator(0, 4).permutation(256)[:unknown_pixels]] = False
    direct = np.einsum("cii->ci", matrix)[..., None] * np.eye(256)
    cells = Cells(shape, side)
    if not coaxial:
        matrix, direct = matrix[:, ::-1], direct[:, ::-1]
    camera = CameraCells.of(cells, matrix.sum(axis=2).astype(np.float32), known)
    projector = coaxial_projector(camera)
    if not coaxial:
        places = np.indices(shape).reshape(2, -1)[:, ::-1].T.astype(np.float32)
        projector_factor = root_factor(matrix.sum(axis=1).astype(np.float32))
        projector = ProjectorCells(cells, projector_factor, places)
    model = DenseTransport(shape, shape, channels, [], {"matrix": direct.astype(np.float32)})

    pictures = exact_pictures(matrix, camera, 60, known)
    previous = None
    if pictures_before:
        first = CellPictures(
            *(
                part[:pictures_before]
                for part in (pictures.lit, pictures.radiance, pictures.variance)
            )
        )
        previous = fit_residual(camera, projector, first, model)
    fitted = fit_residual(camera, projector, pictures, model, previous)
    residual = fitted.transport(camera, shape)

    for channel in range(channels):
        cell = camera.cells.of_ray
        between_cells = (cell[:, None] != cell) & known[:, None] & known
        if not coaxial:
            between_cells = between_cells[::-1]
        truth = np.where(between_cells, matrix[channel], 0)
        relit = np.where(between_cells, residual.channel(channel) @ np.eye(256), 0)
        lit = generator(0, 5).random((camera.cells.count, 8)) < 0.5
        patterns = lit[camera.cells.of_ray].astype(float)
        relit_cells, true_cells = (
            camera.cells.total((light @ patterns).T) for light in (relit, truth)
        )
        error = np.linalg.norm(relit_cells - true_cells) / np.linalg.norm(true_cells)
        assert error < (0.12 if coaxial else 0.25)
        assert relit.min() > -0.02 * truth.max()


@pytest.mark.parametrize("coaxial", [True, False])
def test_the_adjoint_of_a_residual_is_its_transpose(coaxial: bool) -> None:
    shape, random = (12, 10), generator(0, 3)
    light = random.random((2, 120)).astype(np.float32)
    camera = CameraCells.of(Cells(shape, 1), light, np.ones(120, np.bool_))
    pairs = np.array([[0, 1, 3], [2, 1, 9]], np.int32)
    cores = random.standard_normal((2, 3)).astype(np.float32)
    factor = np.zeros((2, 0), np.float32) if coaxial else root_factor(light[:, ::-1])
    residual = Residual(pairs, cores, factor).transport(camera, shape)
    images = random.random((2, 2, 120)).astype(np.float32)
    np.testing.assert_allclose(
        np.vdot(residual.forward(images, range(2))[0], images[1]),
        np.vdot(images[0], residual.adjoint(images, range(2))[1]),
        rtol=1e-3,
    )
