"""The error of relit pictures, from pictures that no fit sees."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rigs.known_matrix import scene_matrices

from rfpipe.methods.error_estimate import HELD_OUT, error_of, held_out_parts, held_out_patterns
from rfpipe.methods.images import Pictures
from rfpipe.provenance import generator
from rfpipe.relighting import picture_errors, relighting_pictures
from rfpipe.transport.arrays import DenseTransport

SHAPE = (24, 32)
TRUTH = scene_matrices("IV", SHAPE)


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
    """Return held-out pictures with noise of a deviation, and the floodlit image."""
    lit = held_out_patterns(shape).reshape(len(HELD_OUT), -1)
    radiance = np.einsum("cmn,pn->pcm", truth, lit).astype(np.float32)
    noise = sigma * generator(seed).standard_normal(radiance.shape)
    variance = np.full_like(radiance, np.square(stated * sigma))
    floodlit = truth.sum(axis=2).astype(np.float32)
    return Pictures(lit, (radiance + noise).astype(np.float32), variance), floodlit


def wrong(part: float) -> DenseTransport:
    """Return a transport whose entries are each off by about so much."""
    return transport(TRUTH * (1 + part * generator(7).standard_normal(TRUTH.shape)))


@pytest.mark.parametrize("shape", [(24, 32), (3, 12, 20), (1, 9), (1, 1), (310, 350)])
def test_patterns_are_shapes_twice_bars_and_spots(shape: tuple[int, ...]) -> None:
    patterns = held_out_patterns(shape)
    assert patterns.shape == (6, *shape)
    assert patterns.any(axis=tuple(range(1, patterns.ndim))).all()
    np.testing.assert_array_equal(patterns[0], patterns[1])
    for index, (kind, parts) in enumerate(zip(HELD_OUT, held_out_parts(shape), strict=True)):
        np.testing.assert_array_equal(parts.sum(axis=0), patterns[index].ravel())
        assert len(parts) <= {"shapes": 1, "bars": 5, "spots": 20}[kind]
        if kind == "spots" and np.prod(shape) > 100:
            assert parts.sum(axis=1).max() <= np.prod(shape) / 64 + 1


@pytest.mark.parametrize(("sigma", "stated"), [(0.0, 1.0), (2e-3, 1.0), (2e-3, 3.0)])
@pytest.mark.parametrize("part", [0.02, 0.2])
def test_the_estimate_is_the_error_without_the_noise(
    part: float, sigma: float, stated: float
) -> None:
    """Also where variances are ten times too large."""
    held, floodlit = held_out(sigma * TRUTH.sum(axis=2).max(), stated=stated)
    dark = ~held.lit
    found = error_of(wrong(part), held, floodlit, dark)
    pictures, truth = (
        np.einsum("cmn,pn->pmc", matrix, held.lit).reshape(6, *SHAPE, -1)
        for matrix in (wrong(part).matrix.astype(np.float64), TRUTH)
    )
    light = floodlit.T.reshape(*SHAPE, -1)
    true, _ = picture_errors(
        pictures, truth, held.lit.reshape(6, *SHAPE), light, dark.reshape(6, *SHAPE)
    )
    assert found.shapes == pytest.approx(true[0], rel=1e-4 if sigma == 0 else 0.2)
    assert found.bars == pytest.approx(true[[2, 4]].mean(), rel=0.5)
    # of each part alone, as it is relit alone
    parts = held_out_parts(SHAPE)
    lit = np.concatenate(parts)
    relit, single = (
        np.einsum("cmn,pn->pmc", matrix, lit).reshape(-1, *SHAPE, len(matrix))
        for matrix in (wrong(part).matrix.astype(np.float64), TRUTH)
    )
    lit = lit.reshape(-1, *SHAPE)
    _, indirect = picture_errors(relit, single, lit, light, ~lit)
    kinds = np.repeat(HELD_OUT, [len(each) for each in parts])
    expected = np.mean([indirect[kinds == kind].mean() for kind in set(HELD_OUT)])
    # noise that drowns indirect light is no evidence of a small error
    assert found.indirect > 0.7 * expected
    if sigma == 0:
        assert found.indirect == pytest.approx(expected, rel=0.3)


def test_each_spot_is_judged_by_itself() -> None:
    """Of two pictures with twenty spots each, one spot is missing altogether."""
    held, _ = held_out(0.0)
    missing = held_out_parts(SHAPE)[3][0]
    lit = held.lit[:, None].astype(np.float32)
    equal = np.eye(held.lit.shape[1])[None]
    pictures = Pictures(held.lit, lit, np.zeros_like(lit))
    ones = np.ones((1, len(missing)), np.float32)
    found = error_of(transport(equal * ~missing), pictures, ones, ~held.lit)
    assert found.spots == pytest.approx(1 / 40, rel=0.3)


@pytest.mark.parametrize("shape", [(8, 8), (14, 15), (16, 18), (32, 36)])
def test_bars_and_spots_light_about_half_of_an_image_at_most(shape: tuple[int, int]) -> None:
    lit = held_out_patterns(shape).mean(axis=(1, 2))
    assert lit.max() < 0.55


@pytest.mark.parametrize("shape", [(12, 14), (16, 18), (22, 24)])
@pytest.mark.parametrize("light", ["direct", "indirect"])
@pytest.mark.parametrize("errors", ["independent", "of indirect light", "nought floodlit"])
def test_the_estimate_is_that_of_parts_relit_alone(
    shape: tuple[int, int], light: str, errors: str
) -> None:
    """Errors of parts cancel where the floodlit picture is known; light of parts adds up."""
    rays = int(np.prod(shape))
    truth = np.eye(rays) + (0.5 / rays if light == "indirect" else 1e-6)
    random = generator(11, rays)
    wrong = 0.2 * random.standard_normal((rays, rays)) / rays
    if errors == "independent":
        wrong = np.diag(0.02 * random.standard_normal(rays))
    if errors == "nought floodlit":
        wrong -= wrong.mean(axis=1, keepdims=True)
    held, floodlit = held_out(0.0, truth=truth[None], shape=shape)
    estimate = error_of(transport(truth[None] + wrong, shape), held, floodlit, ~held.lit)
    pictures = relighting_pictures(shape, 300).reshape(300, -1)
    images, true = (
        (pictures @ matrix.T)[..., None].reshape(300, *shape, 1)
        for matrix in (truth + wrong, truth)
    )
    total, _ = picture_errors(
        images, true, pictures.reshape(300, *shape), floodlit.reshape(*shape, 1)
    )
    for index, kind in enumerate(("shapes", "bars", "spots")):
        mean = total[index::3].mean()
        assert getattr(estimate, kind) == pytest.approx(mean, rel=0.35), kind
    assert estimate.error == pytest.approx(total.mean(), rel=0.2)


@pytest.mark.parametrize("sigma", [0.0, 1e-3, 1.0])
def test_of_no_error_the_estimate_is_what_chance_could_be(sigma: float) -> None:
    held, floodlit = held_out(sigma * TRUTH.sum(axis=2).max())
    found = error_of(transport(TRUTH), held, floodlit, ~held.lit)
    assert np.isfinite([found.error, found.indirect]).all()
    assert (found.error < 1e-5) is (sigma == 0)
    if sigma == 1e-3:
        assert found.error < 0.01


def test_of_darkness_the_estimate_is_nought() -> None:
    held, floodlit = held_out(0.0)
    dark = Pictures(held.lit, 0 * held.radiance, held.variance)
    found = error_of(transport(0 * TRUTH), dark, 0 * floodlit, ~held.lit)
    assert (found.error, found.indirect) == (0.0, 0.0)
