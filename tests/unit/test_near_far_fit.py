"""Near/far acquisition's least squares, and its estimate of its own error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.methods.held_out.estimate import Estimate, Held, estimate
from rfpipe.methods.near_far import solve as near_far_solve
from rfpipe.methods.near_far.model import fit
from rfpipe.methods.near_far.patterns import probe_patterns
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.near_far.solve import Evidence, Observations, Patches, Prior, residual, solve
from rfpipe.methods.near_far.transport import as_transport
from rfpipe.provenance import generator
from rfpipe.scenes import reference_scene
from rfpipe.transport.multiscale.basis import MultiscaleBasis, cells, functions_over

SHARE = 0.002


# --- the fit


def made_up_frames(rays: int, patterns: int) -> Pictures:
    random = np.random.default_rng(0)
    return Pictures(
        random.uniform(0.2, 1, (1, rays)).astype(np.float32),
        random.uniform(1e-4, 1e-3, (1, rays)).astype(np.float32),
        random.random((patterns, rays)) < 0.5,
        random.uniform(0, 1, (patterns, 1, rays)).astype(np.float32),
        random.uniform(1e-3, 1e-2, (patterns, 1, rays)).astype(np.float32),
    )


def observed(basis: MultiscaleBasis, pictures: Pictures) -> Observations:
    return Observations.of(Patches(basis), Evidence.of(pictures, SHARE))


def column_by_column(basis: MultiscaleBasis, pictures: Pictures) -> np.ndarray:
    """What each core alone adds to the pictures, ``F (K F p - p K F 1)``, (M N, pairs)."""
    factor = pictures.floodlit[0].astype(np.float64)
    patterns = pictures.lit.astype(np.float64)
    weights = basis.weights.toarray().astype(np.float64)
    columns = []
    for first, second in zip(basis.first, basis.second, strict=True):
        core = np.zeros((len(basis), len(basis)))
        core[first, second] = core[second, first] = 1
        smooth = weights @ core @ weights.T
        full = smooth @ factor
        columns.append([factor * (smooth @ (factor * p) - p * full) for p in patterns])
    return np.reshape(columns, (len(columns), -1)).T


@pytest.mark.parametrize(("shape", "scales"), [((5, 6), [1]), ((7, 6), [2, 1]), ((2, 3, 4), [2])])
def test_cores_are_those_of_the_dense_least_squares(
    shape: tuple[int, ...], scales: list[int]
) -> None:
    wanted = [np.ones(cells(shape, scale), np.bool_) for scale in scales]
    if len(scales) > 1:
        wanted[1][0, 2:] = False
    parts = [functions_over(*part) for part in zip(scales, wanted, strict=True)]
    basis = MultiscaleBasis(shape, np.concatenate(parts))
    pictures = made_up_frames(int(np.prod(shape)), 6)
    seen = observed(basis, pictures)
    deviations = np.random.default_rng(1).uniform(0.1, 0.5, len(basis.first)).astype(np.float32)

    factor, patterns = pictures.floodlit[0].astype(np.float64), pictures.lit.astype(np.float64)
    spread = (
        pictures.variance[:, 0] + patterns * pictures.floodlit_variance[0] + (SHARE * factor) ** 2
    )
    certainty = 1 / np.sqrt(spread.ravel())
    shown = (pictures.radiance[:, 0] - patterns * factor).ravel()
    system = np.concatenate(
        [certainty[:, None] * column_by_column(basis, pictures), np.diag(1 / deviations)]
    )
    aim = np.concatenate([certainty * shown, np.zeros(len(deviations))])
    expected = np.linalg.lstsq(system, aim, rcond=None)[0]

    found = solve(seen, deviations, 1e-6, 3000)
    assert found.dtype == np.float32
    apart = np.linalg.norm((found - expected) / deviations)
    assert apart < 1e-3 * np.linalg.norm(expected / deviations)
    near = solve(seen, deviations, 1e-6, 3000, start=np.float32(0.9) * found)
    np.testing.assert_allclose(near, found, atol=1e-3 * float(np.abs(found).max()))


@pytest.mark.parametrize("share", [0, -1])
def test_the_fit_ends_where_rounding_is_all_that_is_left(
    monkeypatch: pytest.MonkeyPatch, share: int
) -> None:
    basis = MultiscaleBasis((5, 6), functions_over(1, np.ones((1, 5, 6), np.bool_)))
    seen = observed(basis, made_up_frames(30, 4))
    monkeypatch.setattr(near_far_solve, "_normal", lambda _seen, _deviations, known: share * known)
    assert not solve(seen, np.ones(len(basis.first), np.float32), 1e-6, 100).any()


def test_pixels_taken_together_lose_next_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = reference_scene("IV", (32, 32), channels=1)
    matrix, basis = (
        scene.dense(),
        MultiscaleBasis((32, 32), functions_over(8, np.ones((1, 4, 4), np.bool_))),
    )
    lit = np.kron(np.random.default_rng(0).random((6, 8, 8)) < 0.5, np.ones((4, 4))) > 0
    lit = lit.reshape(6, -1)
    floodlit = matrix.sum(axis=1)[None].astype(np.float32)
    radiance = (lit @ matrix.T)[:, None].astype(np.float32)
    pictures = Pictures(floodlit, 1e-6 * floodlit, lit, radiance, np.full_like(radiance, 1e-6))
    left, weights = [], []
    for largest in (8, 1):
        monkeypatch.setattr(near_far_solve, "_LARGEST_PATCH", largest)
        seen = observed(basis, pictures)
        cores = solve(seen, Prior.of(basis, seen).deviations, 1e-5, 1000)
        left.append(residual(basis, pictures, cores)[~lit])
        weights.append(float((seen.dark + seen.lit).sum(dtype=np.float64)))
    assert np.linalg.norm(left[0]) < 1.01 * np.linalg.norm(left[1])
    assert weights[0] == pytest.approx(weights[1], rel=1e-5)
    assert seen.patches.weights.shape == (1024, len(basis))


def test_channels_are_found_from_what_all_of_them_told_and_dark_ones_stay_dark() -> None:
    scene, shape = reference_scene("IV", (24, 24), channels=3), (24, 24)
    matrix = np.stack([scene.dense(channel) for channel in range(3)])
    lit = probe_patterns(shape, 1, 12).reshape(12, -1)
    matrix[2] = 0
    floodlit = matrix.sum(axis=2).astype(np.float32)
    radiance = np.einsum("mn,crn->mcr", lit, matrix).astype(np.float32)
    variances = (np.full_like(image, 1e-8) for image in (floodlit, radiance))
    pictures = Pictures(floodlit, next(variances), lit, radiance, next(variances))
    model = fit(shape, pictures)
    assert not model.cores[2].any()
    pattern = (np.arange(576) % 24 < 8).astype(np.float32)
    transport = as_transport(shape, [], model, pictures)
    image = transport.forward(np.broadcast_to(pattern, (1, 3, 576)), range(3))[0]
    for found, expected in zip(image[:2], (matrix @ pattern)[:2], strict=True):
        assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected)


def test_without_evidence_the_cores_are_nought() -> None:
    basis = MultiscaleBasis((5, 6), functions_over(1, np.ones((1, 5, 6), np.bool_)))
    pictures = made_up_frames(30, 4)
    direct = pictures.lit[:, None] * pictures.floodlit
    seen = observed(basis, replace(pictures, radiance=direct))
    prior = Prior.of(basis, seen)
    assert not solve(seen, prior.deviations, 1e-4, 100).any()
    assert not prior.learned(np.zeros(len(basis.first), np.float32)).any()


def test_a_priori_light_falls_with_distance_and_is_then_learned_by_groups() -> None:
    basis = MultiscaleBasis((9, 9), functions_over(1, np.ones((1, 9, 9), np.bool_)))
    prior = Prior.of(basis, observed(basis, made_up_frames(81, 4)))
    order = np.argsort(basis.distances(), kind="stable")
    assert (np.diff(prior.deviations[order]) <= 0).all()
    assert (prior.deviations > 0).all()
    cores = np.random.default_rng(2).standard_normal(len(basis.first)).astype(np.float32)
    learned = prior.learned(cores)
    for group in np.unique(prior.group):
        own = prior.group == group
        expected = np.sqrt(np.mean(np.square(cores[own])))
        np.testing.assert_allclose(learned[own], expected, rtol=1e-5)


# --- the estimate


def held_out(
    wrong: float, sigma: float, seed: int, pairs: int = 3, rays: int = 2000
) -> tuple[np.ndarray, Held, float]:
    """Return a prediction, the pictures, and the prediction's true error."""
    random = np.random.default_rng(seed)
    lit = np.repeat(random.random((pairs, rays)) < 0.4, 2, axis=0)
    truth = np.where(lit, random.uniform(0.2, 1, rays), 0.02)[:, None]
    amiss = wrong * np.repeat(random.standard_normal((pairs, 1, rays)), 2, axis=0)
    taken = truth + sigma * random.standard_normal(truth.shape)
    ratio = [
        np.linalg.norm(amiss[first]) / np.linalg.norm(truth[first])
        for first in range(0, 2 * pairs, 2)
    ]
    shapes, strip, spots = ratio if pairs == 3 else 3 * ratio
    true = (2 * shapes + strip + spots) / 4
    return (truth + amiss).astype(np.float32), Held(lit, taken.astype(np.float32)), float(true)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("pairs", [1, 3])
@pytest.mark.parametrize("sigma", [0.0, 0.003, 0.01])
def test_the_estimate_is_the_error_without_the_noise(seed: int, pairs: int, sigma: float) -> None:
    predicted, held, true = held_out(0.005, sigma, seed, pairs)
    found = estimate(predicted, held.radiance, ~held.lit[0])
    assert true / 1.5 < found.error < 1.5 * true
    assert (found.worst == found.error) is (pairs == 1)
    assert found.dark < found.error
    assert 0 < found.indirect < 0.1


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("sigma", [0.0, 0.01, 1.0])
def test_of_no_error_the_estimate_is_what_chance_could_be(seed: int, sigma: float) -> None:
    predicted, held, _ = held_out(0.0, sigma, seed)
    found = estimate(predicted, held.radiance, ~held.lit[0])
    light = float(np.linalg.norm(predicted[0]) ** 2)
    chance = np.sqrt(sigma**2 * np.sqrt(2000) / light)
    assert np.isfinite(found.error)
    if sigma < 1:
        assert chance / 1.5 <= found.error <= 2 * chance + 1e-6


def test_the_worst_is_that_of_the_picture_that_is_predicted_worst() -> None:
    predicted, held, _ = held_out(0.0, 0.0, 0)
    predicted[2:4] *= 1.1
    found = estimate(predicted, held.radiance, ~held.lit[0])
    assert found.worst == found.strip == pytest.approx(0.1, rel=1e-4)
    assert found.error == pytest.approx(0.1 / 4, rel=1e-4)
    predicted[4:] *= 1.2
    found = estimate(predicted, held.radiance, ~held.lit[0])
    assert found.worst == found.spots == pytest.approx(0.2, rel=1e-4)
    assert found.error == pytest.approx((0.1 + 0.2) / 4, rel=1e-4)
    assert found.dark == 0


@pytest.mark.parametrize(
    ("dark", "worst", "expected"),
    [(0.001, 0.012, True), (0.008, 0.012, False), (0.001, 0.05, False)],
)
def test_noise_is_on_lit_pixels_and_everywhere_alike(
    dark: float, worst: float, expected: bool
) -> None:
    found = Estimate(0.01, worst, 0.01, dark, 0.1)
    assert found.is_noise is expected


def test_of_darkness_the_estimate_is_nought() -> None:
    nothing = np.zeros((6, 1, 9), np.float32)
    found = estimate(nothing, nothing, np.ones(9, np.bool_))
    assert found == Estimate(0.0, 0.0, 0.0, 0.0, 0.0)


def test_light_predicted_of_black_pictures_is_an_error_of_one() -> None:
    predicted, held, _ = held_out(0.0, 0.0, 0)
    found = estimate(predicted, np.zeros_like(predicted), ~held.lit[0])
    assert found.error == pytest.approx(1)
    assert 0 < found.dark < 1


def test_pictures_that_noise_drowns_say_nothing() -> None:
    """Of a pattern whose light hardly reaches the camera; shapes count for it."""
    predicted, held, _ = held_out(0.005, 0.001, 0)
    lit = estimate(predicted, held.radiance)
    faint, taken = predicted.copy(), held.radiance.copy()
    noise = generator(3).standard_normal(taken[4:].shape).astype(np.float32)
    faint[4:], taken[4:] = 1e-2, 1e-3 + 0.01 * noise
    found = estimate(faint, taken)
    assert (found.shapes, found.strip) == (lit.shapes, lit.strip)
    assert found.spots == found.shapes
    taken[4:] = 1e-3
    assert estimate(faint, taken).spots == pytest.approx(9)
