"""Multiplexed dual photography on known matrices, and its regression."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from tests.rigs.known_matrix import acquire_matrix, dense, picture_error

from rfpipe import OperatorRig, acquire
from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.config import CameraConfig
from rfpipe.methods import options_of
from rfpipe.methods.base import StateArrays
from rfpipe.methods.dual import Dual
from rfpipe.methods.multiplexed.blocks import BlockLevels, PixelBlocks
from rfpipe.methods.multiplexed.fit import mean_over_neighbours
from rfpipe.methods.multiplexed.kernels import (
    VANISHING,
    PixelPictures,
    _block_form,
    _picture_form,
    fit_pixels,
)
from rfpipe.methods.multiplexed.method import (
    Multiplexed,
    coarse_pattern_count,
    pattern_count,
    ray_pattern_count,
)
from rfpipe.methods.multiplexed.patterns import first_patterns, further_patterns
from rfpipe.stages.evaluate import relative_rms
from rfpipe.testing import MethodContract
from rfpipe.testing.methods import MatrixImages, MethodRun

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

SHAPE = (16, 18)
PROJECTOR = RayDomain(SHAPE)
RAYS = 16 * 18


def sparse_matrix(pixels: int, rays: int, channels: int = 1, seed: int = 0) -> np.ndarray:
    """Return a matrix (C, M, N) in which 1 to 4 random rays light each camera pixel."""
    random = np.random.default_rng(seed)
    matrix = np.zeros((channels, pixels, rays))
    for pixel in range(pixels):
        lit = random.choice(rays, random.integers(1, 5), replace=False)
        matrix[:, pixel, lit] = random.uniform(0.1, 1, (channels, len(lit)))
    return matrix


# --- the contract


class TestSeveralLevels(MethodContract):
    """Projectors with a level of blocks above that of single rays."""

    # smooth light from all rays to all pixels is not what the method assumes
    error = 0.15

    def make_method(self) -> Multiplexed:
        return Multiplexed()

    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return (3, 4), (8, 9)


class TestViews(TestSeveralLevels):
    """Light fields."""

    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return (2, 3, 2), (2, 3, 5)


class TestFewRays(TestSeveralLevels):
    """Projectors of fewer rays than the least number of blocks of a level."""

    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return (4, 4), (3, 3)


# --- acquisitions


@pytest.mark.parametrize(("sigma", "largest"), [(0.0, 1e-4), (0.01, 0.02)])
def test_a_sparse_matrix_takes_fewer_patterns_than_by_dual_photography(
    sigma: float, largest: float
) -> None:
    matrix = sparse_matrix(RAYS, RAYS)
    run = acquire_matrix(Multiplexed(), matrix, SHAPE, SHAPE, tolerance=0.01, sigma=sigma)
    rival = acquire_matrix(Dual(), matrix, SHAPE, SHAPE, sigma=sigma)
    assert relative_rms(dense(run.transport)[0], matrix[0]) < largest
    assert sum(run.patterns) < 0.8 * sum(rival.patterns)


def test_a_rig_of_three_channels_with_noise_is_acquired() -> None:
    matrix = 0.4 * sparse_matrix(80, RAYS, channels=3)
    rig = OperatorRig(matrix, (8, 10), SHAPE, CameraConfig(), seed=1)
    result = acquire(rig, Multiplexed(), progress=False)
    # a random half of the rays, and five spots of 3 x 3 rays
    patterns = np.zeros((6, *SHAPE))
    patterns[0] = np.random.default_rng(1).random(SHAPE) < 0.5
    for number in range(5):
        patterns[number + 1, 3 * number : 3 * number + 3, 2 * number : 2 * number + 3] = 1
    assert picture_error(result.transport, matrix, patterns) < 0.02
    assert result.patterns == sum(row["patterns"] for row in result.transport.level_rows)


def test_views_light_pixels_of_other_views() -> None:
    views = (3, 4, 6)
    matrix = sparse_matrix(72, 72, seed=2)
    run = acquire_matrix(Multiplexed(), matrix, views, views, tolerance=0.01)
    assert relative_rms(dense(run.transport)[0], matrix[0]) < 1e-3
    assert sum(run.patterns) <= 108


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (3, 5), (2, 1, 3)])
def test_projectors_of_few_rays_are_acquired(shape: tuple[int, ...]) -> None:
    rays = RayDomain(shape).size
    matrix = np.random.default_rng(0).random((7, rays))
    run = acquire_matrix(Multiplexed(), matrix, (7, 1), shape, tolerance=0.01)
    difference = np.abs(dense(run.transport)[0] - matrix)
    assert (difference < 0.01 * matrix.sum(axis=1, keepdims=True)).all()


def test_a_dark_scene_ends_after_two_rounds_of_single_rays() -> None:
    run = acquire_matrix(Multiplexed(), np.zeros((30, RAYS)), (5, 6), SHAPE, tolerance=0.01)
    coarse = coarse_pattern_count(BlockLevels(RayDomain(SHAPE)), 0.01)
    assert sum(run.patterns) == 1 + coarse + sum(map(ray_pattern_count, range(2)))
    assert not dense(run.transport).any()


def test_the_transport_is_known_after_the_last_level_alone() -> None:
    run = acquire_matrix(Multiplexed(), sparse_matrix(30, RAYS), (5, 6), SHAPE)
    assert [*run.transport.known_levels] == [len(run.patterns) - 1]


@dataclass
class MaskedImages(MatrixImages):
    """Images in which some camera pixels are masked."""

    masked: tuple[int, ...] = ()

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return images with radiance 0 and infinite variance in masked pixels."""
        radiance, variance = super().read(first, last)
        for images, value in ((radiance, 0), (variance, np.inf)):
            images.reshape(len(images), -1, len(self.matrix))[:, list(self.masked)] = value
        return radiance, variance


def masked_run(matrix: np.ndarray, masked: tuple[int, ...]) -> MethodRun:
    method, camera, projector = Multiplexed(), RayDomain((8, 10)), RayDomain(SHAPE)
    state = method.start(camera, projector, len(matrix), options_of(method))
    schedules, states = [], [state]
    while (schedule := method.next_schedule(state)) is not None:
        images = MaskedImages(matrix, camera.shape, schedule, masked=masked)
        state = method.refine(state, images)
        schedules.append(schedule)
        states.append(state)
    return MethodRun(method.transport(state), schedules, states)


def test_masked_pixels_have_no_light_and_change_no_others() -> None:
    matrix, masked = sparse_matrix(80, RAYS, channels=3), (0, 17, 79)
    run = masked_run(matrix, masked)
    estimate = dense(run.transport)
    assert not estimate[:, masked].any()
    others = np.delete(np.arange(80), masked)
    assert relative_rms(estimate[:, others], matrix[:, others]) < 1e-3
    assert run.patterns == masked_run(matrix, ()).patterns


def test_a_run_of_several_levels_continues_from_stored_arrays() -> None:
    matrix = sparse_matrix(80, RAYS, channels=3)
    run = masked_run(matrix, (3,))
    method = Multiplexed()
    for level, reference in enumerate(run.states):
        changes = [StateArrays(part.arrays, part.attributes) for part in run.changes[:level]]
        restored = type(reference).from_arrays(run.states[0], changes)
        assert restored.is_complete == reference.is_complete
        assert restored.rows == reference.rows
        np.testing.assert_array_equal(
            dense(method.transport(restored)), dense(method.transport(reference))
        )
        schedule = method.next_schedule(restored)
        if level < len(run.schedules):
            assert schedule is not None
            assert schedule.digest() == run.schedules[level].digest()
        else:
            assert schedule is None


# --- the end of an acquisition


def test_rounds_end_once_the_pictures_of_a_round_are_predicted() -> None:
    levels = BlockLevels(RayDomain(SHAPE))
    coarse = coarse_pattern_count(levels, 0.01)
    least, most = (1 + coarse + sum(map(ray_pattern_count, range(rounds))) for rounds in (2, 4))
    sparse = acquire_matrix(Multiplexed(), sparse_matrix(80, RAYS), (8, 10), SHAPE, tolerance=0.01)
    assert least <= sum(sparse.patterns) <= most
    # 60 rays light each pixel: more rounds follow, fewer with a larger tolerance
    random = np.random.default_rng(0)
    many = np.zeros((6, RAYS))
    for row in many:
        row[random.choice(RAYS, 60, replace=False)] = random.uniform(0.1, 1, 60)
    counts = [
        sum(acquire_matrix(Multiplexed(), many, (2, 3), SHAPE, tolerance=tolerance).patterns)
        for tolerance in (0.3, 0.01)
    ]
    assert counts[0] < counts[1]
    assert counts[1] > most


def test_coarser_levels_have_more_patterns_for_a_smaller_tolerance() -> None:
    for tolerance, counts in (
        (0.01, [8, 8, 12, 16, 16, 10, 14]),
        (0.004, [8, 8, 12, 16, 16, 10, 14]),
        (0.002, [11, 11, 17, 16, 16, 10, 14]),
        (0.001, [16, 16, 24, 16, 16, 10, 14]),
        (1e-9, [16, 16, 24, 16, 16, 10, 14]),
    ):
        assert [pattern_count(number, 4, tolerance) for number in range(7)] == counts


def test_rounds_end_at_three_patterns_for_two_rays() -> None:
    matrix = np.random.default_rng(0).random((6, 72))
    run = acquire_matrix(Multiplexed(), matrix, (2, 3), (8, 9), tolerance=1e-9)
    assert sum(run.patterns) >= 108
    assert sum(run.patterns[:-1]) < 108


def test_the_forecast_has_three_rounds_of_single_rays() -> None:
    method, rays = Multiplexed(), RayDomain(SHAPE)
    forecast = method.forecast(rays, rays, 1, options_of(method))
    run = acquire_matrix(method, sparse_matrix(80, RAYS), (8, 10), SHAPE, tolerance=0.01)
    assert forecast.patterns == pytest.approx(sum(run.patterns), rel=0.25)
    assert forecast.max_patterns == 3 * RAYS // 2
    few = RayDomain((2, 3))
    assert method.forecast(few, few, 1, options_of(method)).patterns == 9


# --- patterns


@pytest.mark.parametrize(
    ("finer", "count", "share"),
    [(1, 4, 0.5), (1, 8, 0.5), (1, 16, 0.25), (1, 24, 1 / 6), (0, 4, 0.5), (0, 16, 0.5)],
)
def test_four_patterns_of_a_first_round_light_a_block_and_half_of_them_a_ray(
    finer: int, count: int, share: float
) -> None:
    levels = BlockLevels(RayDomain((64, 64)))
    index = len(levels) - 1 - finer
    lit = first_patterns(levels, index, 3, count)
    assert lit.shape == (count, levels.tree.n_blocks(levels.levels[index]))
    assert lit.mean() == pytest.approx(share, rel=0.1)
    assert not np.array_equal(lit, first_patterns(levels, index, 4, count))


@pytest.mark.parametrize(("shape", "count", "least"), [((64, 64), 8, 1), ((48, 48), 16, 2)])
def test_patterns_tell_all_coarse_blocks_apart(
    shape: tuple[int, int], count: int, least: int
) -> None:
    levels = BlockLevels(RayDomain(shape))
    for key in range(1, 9):
        lit = first_patterns(levels, 0, key, count)
        first, second = np.triu_indices(lit.shape[1], 1)
        assert (lit[:, first] != lit[:, second]).sum(axis=0).min() >= least


def test_further_patterns_light_a_quarter_of_the_rays_in_turn_within_larger_blocks() -> None:
    levels = BlockLevels(RayDomain((64, 64)))
    last = len(levels) - 1
    lit = further_patterns(levels, last, 7, 400)
    assert lit.mean() == pytest.approx(0.25, abs=0.01)
    for coarser in range(last):
        block = levels.tree.block_of_position(levels.levels[coarser])
        dark = [np.mean(np.bincount(block, row) == 0) for row in lit]
        assert np.mean(dark[::2]) < 0.02
        in_turn = dark[1 + 2 * (last - 1 - coarser) :: 2 * last]
        assert np.mean(in_turn) == pytest.approx(0.5, abs=0.05)


# --- blocks


@pytest.mark.parametrize("shape", [SHAPE, (1, 37), (3, 4, 6), (1, 1)])
def test_patterns_light_the_chosen_blocks_of_a_level(shape: tuple[int, ...]) -> None:
    levels = BlockLevels(RayDomain(shape))
    for index, level in enumerate(levels.levels):
        count = levels.tree.n_blocks(level)
        lit = np.random.default_rng(0).random((5, count)) < 0.5
        means = levels.means(levels.patterns(index, lit))
        offset = levels.offsets[index]
        np.testing.assert_allclose(means[:, offset : offset + count], lit, atol=1e-6)
    assert levels.levels[-1] == levels.tree.n_levels - 1
    assert levels.offsets[-1] == means.shape[1]


def test_subdivided_blocks_cover_the_projector_once_and_keep_their_light() -> None:
    levels, pixels = BlockLevels(RayDomain(SHAPE)), 5
    random = np.random.default_rng(0)
    floodlit, is_lit = random.uniform(1, 2, (3, pixels)).astype(np.float32), np.arange(pixels) != 2
    blocks = PixelBlocks.coarsest(levels, floodlit, is_lit)
    light = random.random(blocks.light.shape).astype(np.float32)
    blocks = replace(blocks, light=light)
    totals = [np.bincount(blocks.pixel, light[0], pixels)]
    sizes = np.concatenate([np.diff(levels.tree.starts[level]) for level in levels.levels])
    for index in range(len(levels) - 1):
        thresholds = np.full(pixels, np.median(blocks.light.sum(axis=0)), np.float32)
        blocks = blocks.subdivided(levels, index + 1, thresholds)
        assert (blocks.expected > 0).all()
        covered = np.bincount(blocks.pixel, sizes[blocks.block], pixels)
        np.testing.assert_array_equal(covered, RAYS * is_lit)
        totals.append(np.bincount(blocks.pixel, blocks.light[0], pixels))
        # blocks of all levels remain: some weren't bright enough
        assert len(np.unique(np.searchsorted(levels.offsets, blocks.block, "right"))) == index + 2
    np.testing.assert_allclose(totals[1:], [totals[0]] * (len(totals) - 1), rtol=1e-5)


# --- the regression


def posterior(A: Any, c: Any, N: Any, V: Any) -> tuple[np.ndarray, np.ndarray]:
    """Compute the mean and the variances of the posterior of t, where c = A t + noise."""
    covariance = np.linalg.inv(np.diag(1 / V) + A.T @ np.diag(1 / N) @ A)
    return covariance @ A.T @ (c / N), np.diag(covariance)


@pytest.mark.parametrize(("pictures", "blocks"), [(9, 5), (5, 9), (7, 7), (1, 4), (6, 1)])
def test_both_forms_of_the_regression_agree_with_the_posterior(pictures: int, blocks: int) -> None:
    random = np.random.default_rng(0)
    A = (random.random((pictures, blocks)) < 0.5).astype(np.float64)
    c, N, V = (random.uniform(0.1, 2, count) for count in (pictures, pictures, blocks))
    t, variance = posterior(A, c, N, V)
    for form in (_picture_form, _block_form):
        light, variances = form(A, c, N, V)
        np.testing.assert_allclose(light, t, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(variances, variance, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("pictures", "blocks"), [(300, 400), (300, 290), (100, 300)])
def test_one_bright_block_does_not_hide_the_others(pictures: int, blocks: int) -> None:
    """Its light has 10^8 times the variance of the noise, which float32 doesn't resolve."""
    random = np.random.default_rng(0)
    A = (random.random((pictures, blocks)) < 0.5).astype(np.float64)
    A[0] = 1
    true = random.uniform(0, 1e-2, blocks)
    true[0] = 1
    noise = 1e-3 * float(A[0] @ true)
    N, V = np.full(pictures, noise**2), np.full(blocks, 1e-4)
    V[0] = 1
    c = A @ true + random.normal(0, noise, pictures)
    t, variance = posterior(A, c, N, V)
    form = _block_form if blocks < pictures else _picture_form
    light, variances = form(A, c, N, V)
    deviation = float(np.sqrt(variance.sum()))
    assert np.linalg.norm(light - true) < 1.1 * np.linalg.norm(t - true)
    assert np.linalg.norm(light - t) < 0.5 * deviation
    np.testing.assert_allclose(np.sqrt(variances.sum()), deviation, rtol=0.1)


def test_variances_are_averaged_over_neighbours_by_the_rays_they_share() -> None:
    """Two views of 4 x 5 pixels with blocks of several levels; one pixel is dark."""
    random, camera, levels = np.random.default_rng(0), RayDomain((2, 4, 5)), BlockLevels(PROJECTOR)
    is_lit = np.ones(camera.size, np.bool_)
    is_lit[7] = False
    blocks = PixelBlocks.coarsest(levels, np.ones((1, camera.size), np.float32), is_lit)
    for finest in range(1, len(levels)):
        light = random.random((1, len(blocks.block))).astype(np.float32)
        limits = np.full(camera.size, 0.7, np.float32)
        blocks = replace(blocks, light=light).subdivided(levels, finest, limits)
    variance = random.random(len(blocks.block))

    rays_of = np.concatenate(
        [levels.tree.labels(level).ravel() == b for level in levels.levels
         for b in range(levels.tree.n_blocks(level))]
    ).reshape(-1, PROJECTOR.size)  # fmt: skip
    members = rays_of[blocks.block]
    by_ray = np.zeros((camera.size, PROJECTOR.size))
    np.add.at(by_ray, blocks.pixel, members * (variance / members.sum(axis=1))[:, None])
    grid, lit = by_ray.reshape(2, 4, 5, -1), is_lit.reshape(2, 4, 5)
    mean = np.zeros_like(grid)
    for view, row, column in np.ndindex(2, 4, 5):
        near = (view, slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
        mean[view, row, column] = grid[near][lit[near]].mean(axis=0)
    expected = (members * mean.reshape(camera.size, -1)[blocks.pixel]).sum(axis=1)

    average = mean_over_neighbours(levels, camera, blocks, variance)
    np.testing.assert_allclose(average, expected, rtol=1e-6)


def test_iterations_of_the_regression_agree_with_numpy() -> None:
    """Pixels have no block, fewer blocks than pictures, or more; two patterns divide blocks."""
    random = np.random.default_rng(0)
    pictures, counts = 12, (0, 4, 30)
    means = (random.random((pictures, 40)) < 0.5).astype(np.float32)
    means[0] = 1
    means[5:7] = 0.3
    starts = np.concatenate([[0], np.cumsum(counts)])
    blocks = np.concatenate([random.permutation(40)[:count] for count in counts]).astype(np.int32)
    true = np.where(random.random(len(blocks)) < 0.2, random.uniform(0.5, 1, len(blocks)), 0)
    radiance = np.zeros((len(counts), pictures))
    for pixel, (first, last) in enumerate(pairwise(starts)):
        radiance[pixel] = means[:, blocks[first:last]] @ true[first:last]
    noise, variance = np.full_like(radiance, 1e-5), np.full(len(blocks), 0.1)
    expected = np.zeros(len(blocks))
    for pixel, (first, last) in enumerate(pairwise(starts)):
        active, V = np.arange(first, last), variance.copy()
        for _ in range(3):
            A = means[:, blocks[active]].astype(np.float64)
            within_blocks = (A * (1 - A)) @ V[active]
            t, of_t = posterior(A, radiance[pixel], noise[pixel] + within_blocks, V[active])
            expected[first:last] = 0
            expected[active] = t
            V[active] *= ((np.maximum(t, 0) ** 2 + of_t) / V[active]) ** 1.8
            active = active[V[active] > VANISHING * radiance[pixel, 0] ** 2]
    light = np.zeros(len(blocks))
    pictures = PixelPictures(means, radiance, noise)
    fit_pixels(pictures, starts, blocks, variance, 3, light)
    np.testing.assert_allclose(light, expected, rtol=1e-4, atol=1e-6)
