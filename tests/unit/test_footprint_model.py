"""Parts of the footprint model against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import Candidates, join_views, split_views
from rfpipe.methods.footprints.charts import Chart
from rfpipe.methods.footprints.functions import IndirectBasis, camera_to_projector
from rfpipe.methods.footprints.indirect import IndirectLight, core_operator
from rfpipe.methods.footprints.kernels import BoxGrid, CandidateRows, marginal_factors, match_near
from rfpipe.methods.footprints.pictures import ViewArrays
from rfpipe.methods.footprints.reciprocity import symmetrized, with_transposed
from rfpipe.methods.footprints.weights import marginal_precision
from rfpipe.transport.multiscale import cells, coarsest_scale, functions_over

CAMERA, PROJECTOR = RayDomain((9, 11)), RayDomain((8, 10))


def random_candidates(camera_size: int, projector_size: int, seed: int = 0) -> Candidates:
    """Return candidates at a tenth of all entries, some with weight 0."""
    random = np.random.default_rng(seed)
    keys = np.flatnonzero(random.random(camera_size * projector_size) < 0.1)
    variance, weights = random.uniform(0.1, 2, (2, len(keys))).astype(np.float32)
    weights[random.random(len(keys)) < 0.2] = 0
    return Candidates(camera_size, projector_size, keys, variance, weights)


def random_pictures(camera_size: int, projector_size: int, count: int) -> ViewArrays:
    random = np.random.default_rng(1)
    patterns = (random.random((projector_size, count)) < 0.5).astype(np.float32)
    patterns[:, 0] = 1
    radiance = random.uniform(0.5, 2, (camera_size, count)).astype(np.float32)
    return ViewArrays(patterns, radiance, np.full_like(radiance, 1e-3))


def test_candidates_of_views_are_joined_and_split() -> None:
    parts = [random_candidates(7, 12, seed) for seed in range(3)]
    joined = join_views(parts)
    columns = [part.matrix().toarray() for part in parts]
    np.testing.assert_array_equal(joined.matrix().toarray(), np.concatenate(columns, axis=1))
    for part, expected in zip(split_views(joined, 3), parts, strict=True):
        np.testing.assert_array_equal(part.keys, expected.keys)
        np.testing.assert_array_equal(part.variance, expected.variance)


def test_candidates_of_selected_camera_pixels_are_rows_of_the_matrix() -> None:
    candidates, rows = random_candidates(9, 15), np.array([0, 3, 4, 8])
    expected = candidates.matrix().toarray()[rows]
    np.testing.assert_array_equal(candidates.at(rows).matrix().toarray(), expected)


def test_reciprocity_matches_dense_matrices() -> None:
    candidates = random_candidates(14, 14)
    D = candidates.matrix().toarray()
    np.testing.assert_array_equal(with_transposed(candidates).matrix().toarray(), D)
    np.testing.assert_allclose(symmetrized(candidates).matrix().toarray(), (D + D.T) / 2)


def test_marginal_precision_is_the_inverse_covariance() -> None:
    candidates, pictures = random_candidates(6, 20), random_pictures(6, 20, 13)
    precision = marginal_precision(candidates, pictures)
    actual = precision.apply(pictures.radiance)
    for pixel in range(6):
        entries = candidates.camera_pixels == pixel
        A = pictures.patterns[candidates.projector_pixels[entries]].T.astype(np.float64)
        covariance = np.diag(1.0 / precision.inverse_variance[pixel])
        covariance += A * candidates.variance[entries] @ A.T
        inverse = np.linalg.inv(covariance)
        np.testing.assert_allclose(actual[pixel], inverse @ pictures.radiance[pixel], rtol=2e-3)
        np.testing.assert_allclose(precision.trace[pixel], np.trace(inverse), rtol=2e-3)


def test_precision_without_candidates_is_the_inverse_variance() -> None:
    pictures = random_pictures(4, 5, 7)
    no_pixels, nothing = np.zeros(0, np.int32), np.zeros(0, np.float32)
    rows = CandidateRows(np.zeros(5, np.int64), no_pixels, pictures.patterns)
    factors, trace = marginal_factors(rows, nothing, pictures.inverse_variance())
    assert factors.shape == (0, 7)
    np.testing.assert_allclose(trace, pictures.inverse_variance().sum(axis=1), rtol=1e-6)


@pytest.mark.parametrize("camera_rays", [None, np.array([0, 5, 17, 60])])
def test_core_operator_is_its_equation_and_has_its_adjoint(camera_rays) -> None:
    pictures = random_pictures(CAMERA.size, PROJECTOR.size, 6)
    direct = random_candidates(CAMERA.size, PROJECTOR.size).matrix()
    scale = coarsest_scale(CAMERA.shape)
    functions = functions_over(scale, np.ones(cells(CAMERA.shape, scale), np.bool_))
    mapping = camera_to_projector(direct, pictures.floodlit)
    basis = IndirectBasis(Chart(CAMERA.shape).basis(functions), PROJECTOR, mapping)
    random = np.random.default_rng(2)
    f, camera_gain = random.uniform(0.5, 2, (2, CAMERA.size)).astype(np.float32)
    g, projector_gain = random.uniform(0.5, 2, (2, PROJECTOR.size)).astype(np.float32)
    core_parts = random.normal(size=basis.part_count).astype(np.float32)
    is_diagonal = basis.camera.first == basis.camera.second
    core_parts[len(is_diagonal) :][is_diagonal] = 0  # a diagonal core has no antisymmetric part
    light = IndirectLight(basis, f, g, camera_gain, projector_gain, core_parts)
    operator = core_operator(light, [pictures], camera_rays)
    rows = slice(None) if camera_rays is None else camera_rays
    S = light.core_matrix().toarray()
    indirect = light.f[:, None] * (basis.L @ S @ basis.R.T.toarray()) * light.g
    images = operator.forward(core_parts)
    np.testing.assert_allclose(images, (indirect @ pictures.patterns)[rows], rtol=1e-3, atol=1e-3)
    test_images = random.normal(size=images.shape).astype(np.float32)
    forward_product = np.vdot(images, test_images)
    adjoint_product = np.vdot(core_parts, operator.adjoint(test_images))
    np.testing.assert_allclose(forward_product, adjoint_product, rtol=1e-3, atol=1e-2)


def test_match_near_finds_the_best_box_within_reach() -> None:
    random = np.random.default_rng(3)
    responses, series = (
        array / np.linalg.norm(array, axis=1, keepdims=True)
        for array in (random.normal(size=(2 * 7 * 9, 12)), random.normal(size=(20, 12)))
    )
    responses, series = responses.astype(np.float32), series.astype(np.float32)
    guesses = np.stack([random.uniform(0, 4, (20, 2)), random.uniform(0, 5, (20, 2))], axis=2)
    guesses[::4, 1] = np.nan
    box, correlation = match_near(series, BoxGrid(responses, 7, 9), guesses, 1.0)
    row, column = (np.tile(axis.ravel(), 2) for axis in (np.indices((7, 9)) + 1) / 2)
    for i in range(20):
        distance = [np.maximum(abs(row - y), abs(column - x)) for y, x in guesses[i]]
        near = np.fmin(*distance) <= 1.0
        products = np.where(near, responses @ series[i], 0)
        np.testing.assert_allclose(correlation[i], products.max(), rtol=1e-5)
        assert box[i] == products.argmax()
