"""The estimated error of relit pictures, from held-out pictures."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rigs.known_matrix import scene_matrices

from rfpipe.methods.error_estimate import estimate_error
from rfpipe.methods.held_out import (
    HELD_OUT,
    HELD_OUT_OF_PRIOR,
    held_out_parts,
    held_out_patterns,
)
from rfpipe.methods.images import Pictures
from rfpipe.provenance import generator
from rfpipe.relighting import picture_errors, relighting_pictures
from rfpipe.transport.dense import DenseTransport

SHAPE = (24, 32)
TRUTH = scene_matrices("IV", SHAPE)
BRIGHTEST = TRUTH.sum(axis=2).max()


def transport(matrix: np.ndarray, shape: tuple[int, int] = SHAPE) -> DenseTransport:
    arrays = {"matrix": matrix.astype(np.float32)}
    return DenseTransport(shape, shape, len(matrix), [], arrays)


def held_out(
    sigma: float,
    seed: int = 0,
    stated: float = 1.0,
    truth: np.ndarray = TRUTH,
    shape: tuple[int, int] = SHAPE,
) -> tuple[Pictures, np.ndarray]:
    """Return held-out pictures and the floodlit image.

    The pictures have noise of the standard deviation `sigma`; they state `stated` times as much.
    """
    lit = held_out_patterns(shape).reshape(len(HELD_OUT), -1)
    radiance = np.einsum("cmn,pn->pcm", truth, lit).astype(np.float32)
    noise = sigma * generator(seed).standard_normal(radiance.shape)
    variance = np.full_like(radiance, np.square(stated * sigma))
    floodlit = truth.sum(axis=2).astype(np.float32)
    return Pictures(lit, (radiance + noise).astype(np.float32), variance), floodlit


def inaccurate(relative: float) -> DenseTransport:
    """Return a transport whose entries have a random relative error."""
    return transport(TRUTH * (1 + relative * generator(7).standard_normal(TRUTH.shape)))


@pytest.mark.parametrize("shape", [(24, 32), (3, 12, 20), (1, 9), (1, 1), (310, 350)])
def test_patterns_are_shapes_twice_bars_and_spots(shape: tuple[int, ...]) -> None:
    patterns = held_out_patterns(shape)
    assert patterns.shape == (6, *shape)
    assert patterns.any(axis=tuple(range(1, patterns.ndim))).all()
    np.testing.assert_array_equal(patterns[0], patterns[3])
    assert set(HELD_OUT[:HELD_OUT_OF_PRIOR]) == set(HELD_OUT)
    for index, (kind, parts) in enumerate(zip(HELD_OUT, held_out_parts(shape), strict=True)):
        np.testing.assert_array_equal(parts.sum(axis=0), patterns[index].ravel())
        assert len(parts) <= {"shapes": 1, "bars": 5, "spots": 20}[kind]
        if kind == "spots" and np.prod(shape) > 100:
            assert parts.sum(axis=1).max() <= np.prod(shape) / 64 + 1


@pytest.mark.parametrize(("sigma", "stated"), [(0.0, 1.0), (2e-3, 1.0), (2e-3, 3.0)])
@pytest.mark.parametrize("relative", [0.02, 0.2])
def test_estimates_the_error_without_the_noise(
    relative: float, sigma: float, stated: float
) -> None:
    """Also where the pictures' variances are nine times too large."""
    pictures, floodlit = held_out(sigma * BRIGHTEST, stated=stated)
    dark = ~pictures.lit
    estimate = estimate_error(inaccurate(relative), pictures, floodlit, dark)
    relit, truth = (
        np.einsum("cmn,pn->pmc", matrix, pictures.lit).reshape(6, *SHAPE, -1)
        for matrix in (inaccurate(relative).matrix.astype(np.float64), TRUTH)
    )
    light = floodlit.T.reshape(*SHAPE, -1)
    errors, _ = picture_errors(
        relit, truth, pictures.lit.reshape(6, *SHAPE), light, dark.reshape(6, *SHAPE)
    )
    assert estimate.shapes == pytest.approx(errors[0], rel=1e-4 if sigma == 0 else 0.2)
    assert estimate.bars == pytest.approx(errors[[2, 4]].mean(), rel=0.5)


@pytest.mark.parametrize("sigma", [0.0, 2e-3])
@pytest.mark.parametrize("relative", [0.02, 0.2])
def test_estimates_the_error_of_the_indirect_light_of_parts(relative: float, sigma: float) -> None:
    pictures, floodlit = held_out(sigma * BRIGHTEST)
    estimate = estimate_error(inaccurate(relative), pictures, floodlit, ~pictures.lit)
    parts = held_out_parts(SHAPE)
    lit = np.concatenate(parts)
    relit, truth = (
        np.einsum("cmn,pn->pmc", matrix, lit).reshape(-1, *SHAPE, len(matrix))
        for matrix in (inaccurate(relative).matrix.astype(np.float64), TRUTH)
    )
    lit = lit.reshape(-1, *SHAPE)
    _, errors = picture_errors(relit, truth, lit, floodlit.T.reshape(*SHAPE, -1), ~lit)
    kinds = np.repeat(HELD_OUT, [len(patterns) for patterns in parts])
    expected = np.mean([errors[kinds == kind].mean() for kind in set(HELD_OUT)])
    # indirect light below the noise does not show a small error
    assert estimate.indirect > 0.7 * expected
    if sigma == 0:
        assert estimate.indirect == pytest.approx(expected, rel=0.3)


def test_each_spot_counts_separately() -> None:
    """One of forty spots is missing, in two pictures of twenty."""
    pictures, _ = held_out(0.0)
    missing = held_out_parts(SHAPE)[2][0]
    lit = pictures.lit[:, None].astype(np.float32)
    identity = np.eye(pictures.lit.shape[1])[None]
    exact = Pictures(pictures.lit, lit, np.zeros_like(lit))
    white = np.ones((1, len(missing)), np.float32)
    estimate = estimate_error(transport(identity * ~missing), exact, white, ~pictures.lit)
    assert estimate.spots == pytest.approx(1 / 40, rel=0.3)


@pytest.mark.parametrize("shape", [(8, 8), (14, 15), (16, 18), (32, 36)])
def test_bars_and_spots_light_at_most_about_half_of_the_rays(shape: tuple[int, int]) -> None:
    lit = held_out_patterns(shape).mean(axis=(1, 2))
    assert lit.max() < 0.55


@pytest.mark.parametrize("shape", [(12, 14), (16, 18), (22, 24)])
@pytest.mark.parametrize("light", ["direct", "indirect"])
@pytest.mark.parametrize("errors", ["independent", "of indirect light", "zero in sum"])
def test_estimates_the_error_of_parts_relit_alone(
    shape: tuple[int, int], light: str, errors: str
) -> None:
    """Errors of parts cancel where the floodlit picture is known; light of parts adds up."""
    rays = int(np.prod(shape))
    truth = np.eye(rays) + (0.5 / rays if light == "indirect" else 1e-6)
    random = generator(11, rays)
    error = 0.2 * random.standard_normal((rays, rays)) / rays
    if errors == "independent":
        error = np.diag(0.02 * random.standard_normal(rays))
    if errors == "zero in sum":
        error -= error.mean(axis=1, keepdims=True)
    pictures, floodlit = held_out(0.0, truth=truth[None], shape=shape)
    estimate = estimate_error(
        transport(truth[None] + error, shape), pictures, floodlit, ~pictures.lit
    )
    patterns = relighting_pictures(shape, 300).reshape(300, -1)
    relit, exact = (
        (patterns @ matrix.T)[..., None].reshape(300, *shape, 1)
        for matrix in (truth + error, truth)
    )
    total, _ = picture_errors(
        relit, exact, patterns.reshape(300, *shape), floodlit.reshape(*shape, 1)
    )
    for index, kind in enumerate(("shapes", "bars", "spots")):
        mean = total[index::3].mean()
        assert getattr(estimate, kind) == pytest.approx(mean, rel=0.35), kind
    assert estimate.error == pytest.approx(total.mean(), rel=0.2)


@pytest.mark.parametrize("sigma", [0.0, 1e-3, 1.0])
def test_the_estimate_of_an_exact_transport_is_the_error_within_noise(
    sigma: float,
) -> None:
    pictures, floodlit = held_out(sigma * BRIGHTEST)
    estimate = estimate_error(transport(TRUTH), pictures, floodlit, ~pictures.lit)
    assert np.isfinite([estimate.error, estimate.indirect]).all()
    assert (estimate.error < 1e-5) is (sigma == 0)
    if sigma == 1e-3:
        assert estimate.error < 0.01


def test_the_estimate_of_a_dark_scene_is_zero() -> None:
    pictures, floodlit = held_out(0.0)
    dark = Pictures(pictures.lit, 0 * pictures.radiance, pictures.variance)
    estimate = estimate_error(transport(0 * TRUTH), dark, 0 * floodlit, ~pictures.lit)
    assert (estimate.error, estimate.indirect) == (0.0, 0.0)
