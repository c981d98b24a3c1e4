"""Dual photography on known matrices."""

from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import acquire_matrix, dense, picture_error

from rfpipe.blocks import RayDomain
from rfpipe.methods.dual import Dual
from rfpipe.scenes import reference_scene
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.multilevel import MultilevelTransport

FLOODLIT = np.ones((1, 32, 32))


@pytest.fixture(scope="module")
def wedge() -> np.ndarray:
    return reference_scene("IV", (32, 32), channels=1).dense(0).astype(np.float32)


@pytest.mark.parametrize("shape", [(1, 37), (13, 29), (1, 1), (3, 4, 6)])
def test_a_permutation_is_recovered_exactly(shape: tuple[int, ...]) -> None:
    rays = RayDomain(shape).size
    matrix = np.eye(rays)[np.random.default_rng(1).permutation(rays)]
    run = acquire_matrix(Dual(), matrix, shape, shape)
    np.testing.assert_array_equal(dense(run.transport)[0], matrix)
    # no pixel sees two rays, so each level takes one pattern per child of a block
    assert max(run.patterns) <= max(4, shape[0] if len(shape) == 3 else 0)


def test_the_brightest_channel_decides_on_subdivision() -> None:
    matrix = np.zeros((2, 2, 4))
    matrix[:, 0, 0] = 1.0, 0.01  # bright in the first channel: both are subdivided to single rays
    matrix[:, 1, 3] = (
        0.02,
        0.01,
    )  # dark in both: stored at the level at which they fall below the threshold
    run = acquire_matrix(Dual(), matrix, (1, 2), (2, 2), tolerance=0.1)
    pairs = {
        (pairs.level, int(block), int(pixel)): pairs.values[:, n].tolist()
        for pairs in run.transport.level_responses
        for n, (block, pixel) in enumerate(zip(pairs.block, pairs.pixel, strict=True))
    }
    assert pairs == {
        (0, 0, 1): pytest.approx([0.02, 0.01]),
        (1, 0, 0): pytest.approx([1.0, 0.01]),
    }


def test_responses_are_dropped_stored_or_subdivided(wedge: np.ndarray) -> None:
    run = acquire_matrix(Dual(), wedge, (32, 32), (32, 32), tolerance=1e-2)
    floodlit = wedge.sum(axis=1).max()
    for level, state in enumerate(run.states[1:]):
        row = state.rows[level]
        assert row["nodes"] == row["empty"] + row["rank1"] + row["scalar"] + row["subdivided"]
        assert row["patterns"] == run.patterns[level]
        last = level == len(run.patterns) - 1
        assert row["scalar" if last else "rank1"] == len(state.stored[level])
        assert row["subdivided"] == len(state.frontier)
        assert (state.frontier.values.max(axis=0) >= 0.999e-2 * floodlit).all()
        if not last:
            assert (state.stored[level].values.max(axis=0) < 1.001e-2 * floodlit).all()


@pytest.mark.slow
def test_a_textured_wedge_takes_the_patterns_of_the_prototype() -> None:
    """The thesis-like prototype took 533 patterns with the same threshold."""
    matrix = reference_scene("IV", (64, 64), channels=1).dense(0).astype(np.float32)
    run = acquire_matrix(Dual(), matrix, (64, 64), (64, 64))
    assert 450 <= sum(run.patterns) <= 600
    assert run.patterns[:4] == [1, 4, 16, 64]


def test_stored_responses_are_not_counted_twice(wedge: np.ndarray) -> None:
    run = acquire_matrix(Dual(), wedge, (32, 32), (32, 32))
    assert picture_error(run.transport, wedge, FLOODLIT) < 1e-3


def test_responses_of_a_coaxial_rig_are_distributed_as_the_transpose(
    wedge: np.ndarray, tmp_path: Path
) -> None:
    """This reduces the error of the matrix without patterns, also after storage and truncation."""
    run = acquire_matrix(Dual(), wedge, (32, 32), (32, 32))
    assert run.transport.symmetric
    even = MultilevelTransport((32, 32), (32, 32), 1, [], run.transport.level_responses)
    result, evenly = dense(run.transport)[0], dense(even)[0]
    assert np.linalg.norm(result - wedge) < 0.6 * np.linalg.norm(evenly - wedge)
    assert result.min() >= 0
    save_transport(run.transport, tmp_path / "transport.zarr", scene="wedge")
    stored = open_transport(tmp_path / "transport.zarr")
    np.testing.assert_array_equal(dense(stored)[0], result)
    assert all(stored.truncate(level).symmetric for level in range(6))


def test_responses_of_noncoaxial_rigs_are_distributed_uniformly(wedge: np.ndarray) -> None:
    random = np.random.default_rng(0)
    mirrored = wedge.reshape(32, 32, -1)[:, ::-1].reshape(1024, -1)
    for matrix in (mirrored, random.random((1024, 1024)), wedge[random.permutation(1024)]):
        run = acquire_matrix(Dual(), matrix, (32, 32), (32, 32), tolerance=1e-2)
        assert not run.transport.symmetric


def test_noise_is_not_subdivided(wedge: np.ndarray) -> None:
    """A tolerance far below the noise changes nothing: the noise sets the threshold."""
    sigma = 1e-3 * float(wedge.sum(axis=1).max())
    counts = []
    for tolerance in (1e-3, 1e-7):
        run = acquire_matrix(Dual(), wedge, (32, 32), (32, 32), tolerance=tolerance, sigma=sigma)
        assert np.isfinite(dense(run.transport)).all()
        counts.append(sum(run.patterns))
    assert counts[1] <= 1.05 * counts[0]
    assert counts[1] < 200
    assert picture_error(run.transport, wedge, FLOODLIT) < 0.1


def test_a_level_is_complete_without_culled_blocks_but_not_without_stored_ones() -> None:
    matrix = np.eye(16)
    matrix[:, [10, 11, 14, 15]] = 0  # the lower right block sends no light to any pixel
    dark = acquire_matrix(Dual(), matrix, (4, 4), (4, 4))
    assert (dark.schedules[2].pattern_of_ray.reshape(4, 4)[2:, 2:] == -1).all()
    assert [schedule.complete for schedule in dark.schedules] == [True, True, True]
    matrix[0, 15] = 0.01  # now some, below the threshold
    stored = acquire_matrix(Dual(), matrix, (4, 4), (4, 4), tolerance=0.1)
    assert (stored.schedules[2].pattern_of_ray.reshape(4, 4)[2:, 2:] == -1).all()
    assert [schedule.complete for schedule in stored.schedules] == [True, True, False]


def test_truncation_equals_stopping_at_that_level() -> None:
    matrix = np.random.default_rng(0).random((30, 64)) ** 20
    method = Dual()
    run = acquire_matrix(method, matrix, (5, 6), (8, 8), tolerance=1e-7)
    for level in range(4):
        stopped = method.transport(run.states[level + 1])
        truncated = run.transport.truncate(level)
        assert truncated.level_rows == stopped.level_rows
        np.testing.assert_allclose(dense(truncated), dense(stopped), rtol=1e-5, atol=1e-6)
