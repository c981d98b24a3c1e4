"""The error of a prediction, from two pictures of each held-out pattern."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.methods.adaptive.estimate import Estimate, Held, estimate
from rfpipe.provenance import generator


def held_out(
    wrong: float, sigma: float, seed: int, pairs: int = 3
) -> tuple[np.ndarray, Held, float]:
    """Return a prediction, the pictures, and the prediction's true error."""
    random, rays = np.random.default_rng(seed), 2000
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


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("pairs", [1, 3])
@pytest.mark.parametrize("sigma", [0.0, 0.003, 0.01])
def test_the_estimate_is_the_error_without_the_noise(seed: int, pairs: int, sigma: float) -> None:
    predicted, held, true = held_out(0.005, sigma, seed, pairs)
    found = estimate(predicted, held.radiance, ~held.lit[0])
    assert true / 1.5 < found.error < 1.5 * true
    assert (found.strip == found.shapes) is (pairs == 1)
    assert found.dark < found.error
    assert 0 < found.indirect < 0.1


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sigma", [0.0, 0.01, 1.0])
def test_of_no_error_the_estimate_is_what_chance_could_be(seed: int, sigma: float) -> None:
    predicted, held, _ = held_out(0.0, sigma, seed)
    found = estimate(predicted, held.radiance, ~held.lit[0])
    light = float(np.linalg.norm(predicted[0]) ** 2)
    chance = np.sqrt(sigma**2 * np.sqrt(2000) / light)
    assert np.isfinite(found.error)
    if sigma < 1:
        assert chance / 1.5 <= found.error <= 2 * chance + 1e-6


def test_half_of_the_error_is_of_shapes() -> None:
    predicted, held, _ = held_out(0.0, 0.0, 0)
    predicted[2:4] *= 1.1
    found = estimate(predicted, held.radiance, ~held.lit[0])
    assert found.strip == pytest.approx(0.1, rel=1e-4)
    assert found.error == pytest.approx(0.1 / 4, rel=1e-4)
    predicted[4:] *= 1.2
    found = estimate(predicted, held.radiance, ~held.lit[0])
    assert found.spots == pytest.approx(0.2, rel=1e-4)
    assert found.error == pytest.approx((0.1 + 0.2) / 4, rel=1e-4)
    assert found.dark == 0


def test_of_darkness_the_estimate_is_nought() -> None:
    nothing = np.zeros((6, 1, 9), np.float32)
    found = estimate(nothing, nothing, np.ones(9, np.bool_))
    assert found == Estimate(0.0, 0.0, 0.0, 0.0, 0.0)


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
