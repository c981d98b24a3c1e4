"""Footprint acquisition: near/far acquisition where camera and projector stand apart."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import nnls
from tests.rigs.known_matrix import dense, picture_error

from rfpipe import OperatorRig, acquire
from rfpipe.blocks import RayDomain
from rfpipe.config import CameraConfig
from rfpipe.methods import options_of
from rfpipe.methods.adaptive.footprints.candidates import Candidates, found_anew, reweighted
from rfpipe.methods.adaptive.footprints.kernels import solve_weights
from rfpipe.methods.adaptive.footprints.matching import Templates
from rfpipe.methods.adaptive.footprints.method import ROUNDS, Footprints
from rfpipe.methods.adaptive.footprints.series import Series
from rfpipe.stages.evaluate import relative_rms
from rfpipe.testing.methods import MatrixImages, run_method

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

SIDE = (32, 32)


# --- scenes


def seen_at(camera: tuple[int, ...], projector: tuple[int, ...]) -> np.ndarray:
    """Where each camera pixel looks on the projector: sheared and shifted, some beside it."""
    row, column = np.indices(camera).reshape(2, -1) + 0.5
    down, across = row / camera[0], column / camera[1]
    return np.stack([down * 0.94 + 0.03 * across, across * 0.9 + 0.08 * down + 0.06], axis=1) * (
        projector
    )


def footprints_of(camera: tuple[int, ...], projector: tuple[int, ...]) -> np.ndarray:
    """Direct light: a box of a camera pixel's size about where it looks, (M, N)."""
    place = seen_at(camera, projector)
    along = []
    for axis in (0, 1):
        half = max(1.0, projector[axis] / camera[axis]) / 2
        pixel = np.arange(projector[axis])
        low = np.maximum(pixel, place[:, [axis]] - half)
        along.append(np.clip(np.minimum(pixel + 1, place[:, [axis]] + half) - low, 0, None))
    box = along[0][:, :, None] * along[1][:, None]
    size = np.maximum(1, np.divide(projector, camera)).prod()
    return box.reshape(len(place), -1) / size


def scene(camera: tuple[int, ...], projector: tuple[int, ...]) -> np.ndarray:
    """The matrix of a textured surface that the camera sees from aside, (1, M, N)."""
    albedo = np.random.default_rng(0).choice([0.4, 0.6, 0.8], (8, 8, 1))
    place = seen_at(camera, projector) / projector
    on_projector = (np.indices(projector).reshape(2, -1).T + 0.5) / projector
    cell = [np.clip((8 * each).astype(int), 0, 7) for each in (place, on_projector)]
    own, sent = (albedo[each[:, 0], each[:, 1]].T for each in cell)
    apart = np.linalg.norm(place[:, None] - on_projector, axis=2)
    smooth = np.exp(-4 * apart) * (0.4 + place[:, :1]) / on_projector.shape[0]
    direct = footprints_of(camera, projector)[None] * own[:, :, None]
    matrix = direct + own[:, :, None] * smooth * sent[:, None]
    scale = 1.5 / matrix.sum(axis=2).max()
    return matrix * scale


def errors(matrix: np.ndarray, transport: Any, projector: tuple[int, ...]) -> float:
    """Mean error of relit pictures: an edge, stripes, noise and two spots."""
    shown = np.zeros((5, *projector))
    shown[0, :, : projector[1] // 2] = 1
    shown[1, ::4] = shown[1, 1::4] = 1
    shown[2] = np.random.default_rng(3).random(projector) < 0.5
    shown[3, projector[0] // 3 :, projector[1] // 2 :][:3, :3] = 1
    shown[4, projector[0] // 2 :, projector[1] // 4 :][:4, :4] = 1
    return picture_error(transport, matrix, shown)


def run(matrix: np.ndarray, camera: Any, projector: Any, **options: Any):
    rig = OperatorRig(matrix, camera, projector, CameraConfig(), seed=2)
    return acquire(rig, Footprints(), progress=False, **options)


# --- weights


@pytest.mark.parametrize("seed", range(5))
def test_weights_are_the_best_of_those_that_are_not_negative(seed: int) -> None:
    random = np.random.default_rng(seed)
    lit = (random.random((12, 9)) < 0.5).astype(np.float32)
    lit[7] = lit[3]  # two places with the same patterns share by their variances
    seen = random.normal(1, 1, (1, 9)).astype(np.float32)
    certainty = random.uniform(1, 1e4, (1, 9)).astype(np.float32)
    ridge, expected = random.uniform(0.1, 10, (2, 12)).astype(np.float32)
    rays = np.arange(12, dtype=np.int32)
    start = np.maximum(0, random.normal(0, 1, 12)).astype(np.float32) * (seed > 0)
    given = rays, ridge, expected, start, lit, certainty, seen
    found = solve_weights(np.array([0, 12]), *given, 0.0)
    rows = [lit.T * np.sqrt(certainty.T), np.diag(np.sqrt(ridge))]
    goal = [(seen * np.sqrt(certainty))[0], expected * np.sqrt(ridge)]
    best, _ = nnls(np.concatenate(rows), np.concatenate(goal))
    np.testing.assert_allclose(found, best, rtol=1e-3, atol=1e-4)


def test_of_two_places_with_the_same_patterns_neighbours_tell_which_is_seen() -> None:
    side, own, elsewhere = RayDomain((12, 12)), 5 * 12 + 5, 9 * 12 + 1
    lit = (np.random.default_rng(0).random((side.size, 25)) < 0.5).astype(np.float32)
    lit[:, 0], lit[elsewhere] = 1, lit[own]
    series = Series(lit, lit.copy(), np.full_like(lit, 1e-6))
    place = np.arange(side.size)
    place[own] = elsewhere
    ones, nothing = np.ones(side.size, np.float32), np.zeros_like(lit)
    found = Candidates(np.arange(side.size) * side.size + place, ones, ones)
    again = found_anew(series, found, nothing, side, Templates.of(side, lit, 1.0))
    weights = reweighted(series, again, nothing).matrix(side.size, side.size).toarray()
    assert weights[own, own] > 0.9
    assert weights[own, elsewhere] < 0.1


# --- acquisitions


@pytest.mark.parametrize(("camera", "projector"), [(SIDE, SIDE), ((23, 31), (29, 19))])
def test_a_diffuse_scene_is_good_after_few_patterns(camera: Any, projector: Any) -> None:
    matrix = scene(camera, projector)
    result = run(matrix, camera, projector, target_error=0.02)
    error, told = (
        errors(matrix, result.transport, projector),
        result.history["estimated_error"].iloc[-1],
    )
    assert result.patterns <= 1 + 6 + sum(ROUNDS[:2])
    assert error < 0.024
    assert told <= 0.02
    assert 1 / 1.6 < told / error < 1.6


@pytest.mark.slow
def test_a_mirror_goes_to_dual_photography_and_says_how_good_it_is() -> None:
    random = np.random.default_rng(0)
    size = 16 * 16
    matrix = np.eye(size)[random.permutation(size)] * random.uniform(0.5, 1, (size, 1))
    matrix += np.eye(size)[random.permutation(size)] * 0.5
    result = run(matrix, (16, 16), (16, 16), target_error=0.01)
    rows = result.transport.level_rows
    dual = [row for row in rows if row["level"] > len(ROUNDS) and row["patterns"]]
    assert dual
    error = errors(matrix[None], result.transport, (16, 16))
    told = result.history["estimated_error"].iloc[-1]
    assert error < 0.03
    assert told > error / 2


@pytest.mark.slow
def test_a_limit_of_patterns_is_kept() -> None:
    shape = (16, 16)
    matrix = scene(shape, shape)
    # also where the target is met, and pictures to judge by are all that is left to show
    for limit, target in ((1, 1e-4), (5, 1e-4), (40, 1e-4), (2, 0.5), (28, 0.5), (29, 0.5)):
        run_of = run_method(Footprints(), matrix, shape, shape, patterns=limit, target_error=target)
        assert sum(run_of.patterns) <= limit
        assert np.isfinite(dense(run_of.transport)).all()


BAD = np.zeros((20, 20), bool)
BAD[3, 4] = BAD[11, 12:15] = True


class Masked(MatrixImages):
    """Images with pixels that the camera doesn't know."""

    def read(self, first: int, last: int):
        radiance, variance = super().read(first, last)
        radiance[:, BAD], variance[:, BAD] = 0, np.inf
        return radiance, variance


def test_pixels_that_are_unknown_are_no_evidence() -> None:
    matrix = scene((20, 20), (20, 20))
    own, domain, good = Footprints(), RayDomain((20, 20)), ~BAD.ravel()

    def acquired(images_of: type[MatrixImages]) -> np.ndarray:
        state = own.start(domain, domain, 1, options_of(own, patterns=57))
        for _ in range(own.n_levels(domain, domain)):
            state = own.refine(state, images_of(matrix, (20, 20), own.schedule(state), 2e-3))
        assert all(np.isfinite(each.error) for each in state.estimates)
        return dense(own.transport(state))[0]

    whole, masked = acquired(MatrixImages), acquired(Masked)
    assert np.isfinite(masked).all()
    assert not masked[~good].any()
    truth = matrix[0][good]
    assert relative_rms(masked[good], truth) < 1.3 * relative_rms(whole[good], truth)


@pytest.mark.slow
@pytest.mark.parametrize("shapes", [((1, 1), (1, 1)), ((1, 9), (12, 11)), ((2, 9, 9), (2, 11, 10))])
def test_small_and_stacked_domains_end(shapes: Any) -> None:
    camera, projector = shapes
    random = np.random.default_rng(0)
    matrix = random.random((1, int(np.prod(camera)), int(np.prod(projector)))) ** 8
    done = run_method(Footprints(), matrix, camera, projector, sigma=1e-3)
    assert np.isfinite(dense(done.transport)).all()
