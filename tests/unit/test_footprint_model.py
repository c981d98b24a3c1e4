"""Parts of the footprint model against dense linear algebra."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import (
    Candidates,
    StoredCandidates,
    join_pixels,
)
from rfpipe.methods.footprints.charts import Chart
from rfpipe.methods.footprints.functions import IndirectBasis, camera_to_projector
from rfpipe.methods.footprints.indirect import IndirectLight, core_operator
from rfpipe.methods.footprints.kernels import CandidateRows, marginal_factors
from rfpipe.methods.footprints.matching import Boxes
from rfpipe.methods.footprints.matching_kernels import box_lengths, match_all, match_near
from rfpipe.methods.footprints.model import footprint_arrays
from rfpipe.methods.footprints.pictures import ViewArrays
from rfpipe.methods.footprints.reciprocity import symmetrized, with_transposed
from rfpipe.methods.footprints.weights import (
    LowRankPrecision,
    TriangularPrecision,
    marginal_precision,
)
from rfpipe.transport.multiscale import cells, coarsest_scale, functions_over

CAMERA, PROJECTOR = RayDomain((9, 11)), RayDomain((8, 10))


def random_candidates(
    camera_size: int, projector_size: int, seed: int = 0, share: float = 0.1
) -> Candidates:
    """Return candidates at a share of all entries, some with weight 0."""
    random = np.random.default_rng(seed)
    keys = np.flatnonzero(random.random(camera_size * projector_size) < share)
    variance, weights = random.uniform(0.1, 2, (2, len(keys))).astype(np.float32)
    weights[random.random(len(keys)) < 0.2] = 0
    return Candidates(camera_size, projector_size, keys, variance, weights)


def random_pictures(camera_size: int, projector_size: int, count: int) -> ViewArrays:
    random = np.random.default_rng(1)
    patterns = (random.random((projector_size, count)) < 0.5).astype(np.float32)
    patterns[:, 0] = 1
    radiance = random.uniform(0.5, 2, (camera_size, count)).astype(np.float32)
    return ViewArrays(patterns, radiance, np.full_like(radiance, 1e-3))


def test_candidates_of_views_are_stored() -> None:
    parts = [random_candidates(7, 12, seed) for seed in range(3)]
    stored = StoredCandidates.of(parts)
    assert len(stored) == 3
    for actual, expected in zip(stored, parts, strict=True):
        np.testing.assert_array_equal(actual.keys, expected.keys)
        np.testing.assert_array_equal(actual.variance, expected.variance)
        np.testing.assert_array_equal(actual.weights, expected.weights)
    rows = stored.between(1, 2, 5)
    np.testing.assert_array_equal(rows.matrix().toarray(), parts[1].matrix().toarray()[2:5])


def test_footprints_of_views_are_joined_in_a_transport() -> None:
    parts = [random_candidates(7, 12, seed) for seed in range(3)]
    channels = [[replace(it, weights=scale * it.weights) for it in parts] for scale in (1, 2)]
    arrays = footprint_arrays([StoredCandidates.of(views) for views in channels], 0.5)
    expected = np.concatenate([part.matrix().toarray() for part in parts], axis=1)
    for weights, scale in zip(arrays["footprints"], (0.5, 1.0), strict=True):
        content = weights, arrays["footprints_columns"], arrays["footprints_starts"]
        actual = csr_array(content, shape=expected.shape)
        assert actual.has_canonical_format
        np.testing.assert_array_equal(actual.toarray(), np.float32(scale) * expected)


def test_candidates_of_no_camera_pixel_are_stored() -> None:
    nothing = random_candidates(4, 6, share=0)
    (stored,) = StoredCandidates.of([nothing])
    assert not stored.matrix().nnz


def test_candidates_of_ranges_of_camera_pixels_are_joined_and_split() -> None:
    candidates = random_candidates(9, 15)
    parts = [candidates.between(first, last) for first, last in ((0, 4), (4, 5), (5, 9))]
    matrices = [part.matrix().toarray() for part in parts]
    np.testing.assert_array_equal(np.concatenate(matrices), candidates.matrix().toarray())
    np.testing.assert_array_equal(join_pixels(parts).keys, candidates.keys)


def test_candidates_of_selected_camera_pixels_are_rows_of_the_matrix() -> None:
    candidates, rows = random_candidates(9, 15), np.array([0, 3, 4, 8])
    expected = candidates.matrix().toarray()[rows]
    np.testing.assert_array_equal(candidates.at(rows).matrix().toarray(), expected)


@pytest.mark.parametrize("views", [1, 3])
def test_reciprocity_matches_dense_matrices(views: int) -> None:
    rays = 5 * views
    stored = StoredCandidates.of([random_candidates(rays, 5, seed) for seed in range(views)])
    D, completed, mean = (
        np.concatenate([part.matrix().toarray() for part in parts], axis=1)
        for parts in (stored, with_transposed(stored), symmetrized(stored))
    )
    np.testing.assert_array_equal(completed, D)
    np.testing.assert_allclose(mean, (D + D.T) / 2)


@pytest.mark.parametrize(("share", "kind"), [(0.1, LowRankPrecision), (0.7, TriangularPrecision)])
def test_marginal_precision_is_the_inverse_covariance(share: float, kind: type) -> None:
    candidates, pictures = random_candidates(6, 20, 0, share), random_pictures(6, 20, 13)
    precision = marginal_precision(candidates, pictures)
    assert isinstance(precision, kind)
    actual = precision.apply(pictures.radiance)
    for pixel in range(6):
        entries = candidates.camera_pixels == pixel
        A = pictures.patterns[candidates.projector_pixels[entries]].T.astype(np.float64)
        covariance = np.diag(1.0 / pictures.inverse_variance()[pixel])
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
    mapping = camera_to_projector([direct], pictures.floodlit)
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


@pytest.fixture
def boxes() -> Boxes:
    return Boxes(RayDomain((4, 5)), (1.6, 3.2))


def box_averages(boxes: Boxes) -> np.ndarray:
    """Return the share of each pixel in each box, (boxes, N), by overlaps of single pixels."""
    numbers = np.arange(np.prod(boxes.shape))
    side, places = boxes.width(numbers)[:, None], np.indices(boxes.projector.image_shape) + 0.5
    shares = np.ones((len(numbers), boxes.projector.size))
    for centre, place in zip(boxes.centre(numbers).T[..., None], places, strict=True):
        distance = abs(place.ravel() - centre)
        shares *= np.clip((side + 1) / 2 - distance, 0, np.minimum(1, side))
    return shares / side**2


def test_responses_are_averages_over_boxes(boxes: Boxes) -> None:
    patterns = np.random.default_rng(4).random((20, 6)).astype(np.float32)
    numbers = np.arange(np.prod(boxes.shape))
    expected = box_averages(boxes) @ patterns
    np.testing.assert_allclose(boxes.responses(numbers, patterns), expected, rtol=1e-5)
    lengths = [box_lengths(patterns.reshape(4, 5, 6), averages) for averages in boxes.averages]
    lengths = [by_parity.swapaxes(1, 2).reshape(7, -1)[:, :-1].ravel() for by_parity in lengths]
    np.testing.assert_allclose(np.concatenate(lengths), np.linalg.norm(expected, axis=1), rtol=1e-5)


def test_best_box_is_found_among_all_and_within_reach(boxes: Boxes) -> None:
    random = np.random.default_rng(3)
    pixels, series = random.normal(size=(20, 12)), random.normal(size=(20, 12))
    series = (series / np.linalg.norm(series, axis=1, keepdims=True)).astype(np.float32)
    responses = box_averages(boxes) @ pixels
    length = np.linalg.norm(responses, axis=1)
    products = series @ (responses / length[:, None]).T
    image, scales = pixels.reshape(4, 5, 12).astype(np.float32), np.zeros((2, 7, 10))
    scales[..., :-1] = 1 / length.reshape(boxes.shape)
    scales = np.ascontiguousarray(scales.reshape(2, 7, 5, 2).swapaxes(2, 3), np.float32)
    images = (series @ pixels.T.astype(np.float32)).reshape(-1, 4, 5)
    box, correlation = match_all(images, boxes.averages, scales)
    np.testing.assert_array_equal(box, products.argmax(axis=1))
    np.testing.assert_allclose(correlation, products.max(axis=1), rtol=1e-4)
    guesses = np.stack([random.uniform(0, 4, (20, 2)), random.uniform(0, 5, (20, 2))], axis=2)
    guesses[::4, 1] = np.nan
    box, correlation = match_near(series, image, boxes.averages, scales, guesses, 1.0)
    row, column = boxes.centre(np.arange(len(length))).T
    for i in range(20):
        distance = [np.maximum(abs(row - y), abs(column - x)) for y, x in guesses[i]]
        near = np.where(np.fmin(*distance) <= 1.0, products[i], 0)
        np.testing.assert_allclose(correlation[i], near.max(), rtol=1e-4)
        assert box[i] == near.argmax()
