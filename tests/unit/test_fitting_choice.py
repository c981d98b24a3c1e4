"""Models of a fit: selected by held-out pictures, refused if these are predicted poorly."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from tests.rigs.structured_light import Shot, shot

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.fitting import Series, fit_transport
from rfpipe.fitting.choose import FOOTPRINTS
from rfpipe.fitting.codes import code_patterns
from rfpipe.fitting.footprints import solve_footprints
from rfpipe.fitting.held_out import dependent_groups, dependents, held_out_pictures
from rfpipe.fitting.least_squares import solve_least_squares
from rfpipe.fitting.noise import with_estimated_noise
from rfpipe.fitting.surfaces import surfaces_of
from rfpipe.methods.footprints.candidates import Candidates

PROJECTOR, CAMERA = (30, 50), (40, 48)


def series_of(capture: Shot) -> Series:
    pictures = capture.pictures[:, None]
    rounding = np.full_like(pictures, 1 / 12 / 255**2)
    shapes = capture.camera_shape, capture.projector_shape
    return Series(*shapes, capture.patterns[:, None], pictures, rounding, capture.names)


@lru_cache
def gray_code(seed: int = 3, **settings: float) -> Shot:
    return shot(PROJECTOR, CAMERA, seed, **settings)


def test_footprints_are_chosen_for_gray_code_and_place_pixels() -> None:
    capture = gray_code()
    result = fit_transport(series_of(capture))
    assert result.model == FOOTPRINTS.name
    assert result.error == result.errors[FOOTPRINTS.name] == min(result.errors.values())
    places = result.transport.correspondence()
    inside = ((capture.places > 0) & (capture.places < np.array(PROJECTOR)[:, None])).all(axis=0)
    assert not (places.mask.ravel() & ~inside).sum() > 0.02 * inside.sum()
    truth = np.moveaxis(capture.places.reshape(2, *CAMERA), 0, -1)
    distance = np.linalg.norm(places.places - truth, axis=-1)[places.mask]
    assert places.mask.mean() > 0.6 * inside.mean()
    assert np.median(distance) < 0.15
    assert np.mean(distance > 2) < 0.01


def test_pictures_of_noise_are_refused() -> None:
    series = series_of(gray_code())
    noise = np.random.default_rng(1).random(series.radiance.shape, np.float32)
    with pytest.raises(InputError, match="show codes that no ray"):
        fit_transport(replace(series, radiance=noise))
    assert fit_transport(replace(series, radiance=noise), anyway=True).notes


def test_pictures_of_noise_under_random_patterns_are_refused() -> None:
    random = np.random.default_rng(3)
    patterns = (random.random((30, 1, 400)) < 0.5).astype(np.float32)
    noise = random.random((30, 1, 300)).astype(np.float32)
    series = Series((15, 20), (20, 20), patterns, noise, np.zeros_like(noise))
    with pytest.raises(InputError, match="by the mean picture, scaled by each pattern's light"):
        fit_transport(series)


def test_exchanged_pictures_are_refused_by_name() -> None:
    series = series_of(gray_code())
    radiance = series.radiance.copy()
    radiance[[4, 15]] = radiance[[15, 4]]
    with pytest.raises(InputError, match=r"05\.png.*16\.png"):
        fit_transport(replace(series, radiance=radiance))


@pytest.mark.parametrize("size", [(20, 33), (17, 50)])
def test_a_code_of_another_size_is_refused(size: tuple[int, int]) -> None:
    series, spec = series_of(gray_code()), f"gray:{size[1]}x{size[0]},white=last"
    readers = code_patterns(spec, len(series.patterns)).readers
    patterns = np.stack([read().reshape(1, -1) for read in readers])
    with pytest.raises(InputError, match=r"\d+% of the lit pixels show codes that no ray"):
        fit_transport(replace(series, patterns=patterns, projector_shape=size))


@pytest.mark.slow
def test_gray_code_without_complements_is_placed_as_well() -> None:
    capture = gray_code(name="gray:{1}x{0},plain,white=last")
    result = fit_transport(series_of(capture))
    assert result.model == FOOTPRINTS.name
    places = result.transport.correspondence()
    truth = np.moveaxis(capture.places.reshape(2, *CAMERA), 0, -1)
    distance = np.linalg.norm(places.places - truth, axis=-1)[places.mask]
    assert np.median(distance) < 0.15
    assert np.mean(distance > 2) < 0.02


def test_footprints_give_no_negative_light() -> None:
    transport = solve_footprints(series_of(gray_code(indirect=0.3)), [])
    single_rays = np.eye(PROJECTOR[0] * PROJECTOR[1], dtype=np.float32)[::7, None]
    light = transport.forward(single_rays, [0])
    assert light.min() > -1e-4 * light.max()


def test_pictures_and_complements_are_held_out_together() -> None:
    series = series_of(gray_code())
    groups = dependent_groups(series.patterns)
    pairs = groups[:-1].reshape(-1, 2)
    assert (pairs[:, 0] == pairs[:, 1]).all()
    assert len(np.unique(pairs[:, 0])) == len(pairs)
    assert groups[-1] == -1  # white is predicted by several pairs
    held_out = held_out_pictures(series)
    np.testing.assert_array_equal(dependents(series, held_out), held_out)
    np.testing.assert_array_equal(dependents(series, held_out[:1]), held_out[:1] // 2 * 2 + [0, 1])
    # no other pictures predict coarse stripes
    assert not np.isin(held_out, [0, 1, 12, 13]).any()


def test_repeated_pictures_are_held_out_together() -> None:
    random = np.random.default_rng(4).random((6, 1, 30)).astype(np.float32)
    groups = dependent_groups(np.concatenate([random, random[2:3]]))
    assert groups[6] == groups[2]
    assert len(np.unique(groups)) == 6


@pytest.mark.parametrize("sigma", [0.004, 0.02])
def test_noise_is_estimated_from_combinations_that_vanish(sigma: float) -> None:
    series = series_of(gray_code(noise=sigma))
    estimate = np.sqrt(with_estimated_noise(series).variance[0, 0])
    # black without noise was subtracted; 8 bits are rounded
    expected = np.hypot(sigma, 1 / 255 / np.sqrt(12))
    assert np.median(estimate) == pytest.approx(expected, rel=0.1)


def test_exact_pictures_have_no_noise() -> None:
    patterns = np.random.default_rng(5).random((40, 1, 12)).astype(np.float32)
    matrix = np.random.default_rng(6).random((9, 12)).astype(np.float32)
    radiance = patterns @ matrix.T
    exact = Series((3, 3), (3, 4), patterns, radiance, np.zeros_like(radiance))
    assert with_estimated_noise(exact) is exact


def test_least_squares_has_no_negative_light() -> None:
    random = np.random.default_rng(7)
    patterns = (random.random((30, 1, 60)) < 0.5).astype(np.float32)
    matrix = random.random((20, 60)) ** 8
    radiance = (patterns @ matrix.T).astype(np.float32)
    noisy = radiance + 0.02 * random.standard_normal(radiance.shape).astype(np.float32)
    series = Series((4, 5), (6, 10), patterns, noisy, np.full_like(radiance, 0.02**2))
    transport = solve_least_squares(series, [])
    entries = transport.toarray()
    assert entries.min() >= 0
    fitted = transport.forward(patterns, [0])
    clipped = np.maximum(np.linalg.lstsq(patterns[:, 0], noisy[:, 0], rcond=None)[0], 0)
    without_gradients = patterns[:, 0] @ clipped - radiance[:, 0]
    assert np.linalg.norm(fitted[:, 0] - radiance[:, 0]) < 0.2 * np.linalg.norm(without_gradients)
    assert np.linalg.norm(fitted - radiance) < 0.02 * np.linalg.norm(radiance)


@pytest.mark.slow
def test_unknown_pixels_have_no_transport_and_no_influence() -> None:
    series = series_of(gray_code())
    unknown = np.zeros(series.radiance.shape[2], np.bool_)
    unknown[100:140] = True
    variance = np.where(unknown, np.inf, series.variance).astype(np.float32)
    radiance = np.where(unknown, 7, series.radiance).astype(np.float32)
    damaged = replace(series, variance=variance, radiance=radiance)
    for solve in (solve_least_squares, solve_footprints):
        white = np.ones((1, 1, series.patterns.shape[2]), np.float32)
        image = solve(damaged, []).forward(white, [0]).ravel()
        assert np.abs(image[unknown]).max() < 0.05
        assert image[~unknown].mean() == pytest.approx(
            series.radiance[-1, 0, ~unknown].mean(), rel=0.1
        )


def test_surfaces_follow_an_affine_map_among_misplaced_pixels() -> None:
    camera, projector = RayDomain((30, 40)), RayDomain((50, 60))
    row, column = np.indices(camera.shape)
    truth = np.stack([5.2 + 0.9 * row + 0.2 * column, 8.4 - 0.1 * row + 1.1 * column])
    random = np.random.default_rng(8)
    noisy = truth + 0.3 * random.standard_normal(truth.shape)
    wrong = random.random(camera.shape) < 0.1
    noisy[:, wrong] = random.random((2, wrong.sum())) * [[50], [60]]
    ray = np.clip(np.floor(noisy), 0, [[[49]], [[59]]]).astype(np.int64)
    keys = (np.arange(camera.size) * projector.size + (ray[0] * 60 + ray[1]).ravel()).astype(
        np.int64
    )
    ones = np.ones(camera.size, np.float32)
    surfaces = surfaces_of(
        Candidates(camera.size, projector.size, keys, ones, ones), camera, projector
    )
    distance = np.linalg.norm(surfaces.places - truth, axis=0)[3:-3, 3:-3]
    assert np.median(distance) < 0.25
    assert np.quantile(distance, 0.95) < 0.6
    np.testing.assert_allclose(
        np.median(surfaces.slopes.reshape(4, -1), axis=1), [0.9, 0.2, -0.1, 1.1], atol=0.06
    )
    assert surfaces.smooth.mean() > 0.95
