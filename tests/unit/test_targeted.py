"""Symmetric and dual photography ended at an error that held-out pictures tell."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from figures.hard_scenes import hard_cases
from numpy.typing import NDArray
from tests.helpers import dense, picture_error, scene_matrices

import rfpipe
from rfpipe.blocks import RayDomain
from rfpipe.methods import Method, Pack, get_method, options_of
from rfpipe.methods.adaptive.estimate import HELD_OUT
from rfpipe.provenance import generator
from rfpipe.testing.methods import MatrixImages, MethodRun, run_method
from rfpipe.transport import Transport

SHAPE = (16, 16)
WEDGE = scene_matrices("IV", SHAPE)
BOTH = pytest.mark.parametrize("name", ["symmetric", "dual"])


def run(name: str, matrix: NDArray[Any], sigma: float = 0.0, **options: Any) -> MethodRun:
    return run_method(get_method(name), matrix, SHAPE, SHAPE, sigma=sigma, **options)


def pictures_error(transport: Transport, matrix: NDArray[Any]) -> float:
    """Mean error of pictures of blocks, edges and spots."""
    random = generator(3)
    shape = transport.projector_shape
    lit = np.zeros((8, *shape), np.float32)
    for index, pattern in enumerate(lit[:4]):
        side = 2**index
        blocks = random.integers(0, 2, (shape[0] // side + 1, shape[1] // side + 1))
        pattern[:] = blocks.repeat(side, 0).repeat(side, 1)[: shape[0], : shape[1]]
    lit[4, :, : shape[1] // 3], lit[5, : shape[0] // 3] = 1, 1
    lit[6, 2:5, 3:6], lit[7, 9:11, 7:9] = 1, 1
    return picture_error(transport, matrix, lit)


def last_estimate(transport: Transport) -> float:
    return float(transport.history["estimated_error"].iloc[-1])


def true_error(transport: Transport, matrix: NDArray[Any]) -> float:
    """Mean error of the pictures that people relight."""
    lit = rfpipe.relighting_pictures(SHAPE, 96, 5)
    truth = np.einsum("cmn,pn->pmc", matrix, lit.reshape(96, -1)).reshape(96, *SHAPE, -1)
    floodlit = matrix.sum(axis=2).T.reshape(*SHAPE, -1)
    return float(
        rfpipe.picture_errors(transport.relight_batch(lit), truth, lit, floodlit)[0].mean()
    )


@BOTH
@pytest.mark.parametrize("target", [0.05, 0.01, 0.002])
def test_the_target_is_met_and_the_estimate_is_the_error(name: str, target: float) -> None:
    found = run(name, WEDGE, target_error=target)
    assert last_estimate(found.transport) <= target
    true = true_error(found.transport, WEDGE)
    assert true <= 1.2 * target
    assert true / 1.5 < last_estimate(found.transport) < 1.5 * true


@BOTH
def test_held_out_pictures_are_all_that_it_costs(name: str) -> None:
    """The inner method asks for the same patterns, and its tolerance follows from the target."""
    targeted = run(name, WEDGE, target_error=0.004)
    plain = run(name, WEDGE, tolerance=0.3 * 0.004)
    counted = sum(targeted.patterns)
    assert counted == sum(plain.patterns) + len(HELD_OUT)
    assert counted == sum(row["patterns"] for row in targeted.transport.level_rows)
    blocks = [each for each in targeted.schedules if each.pattern_of_ray is not None and each.count]
    assert [replace(each, level=0).digest() for each in blocks] == [
        replace(each, level=0).digest() for each in plain.schedules
    ]
    np.testing.assert_array_equal(dense(targeted.transport), dense(plain.transport))


@BOTH
def test_what_predicts_best_is_returned(name: str, caplog: pytest.LogCaptureFixture) -> None:
    """Where the last level shows another scene, that of an upper level; and it says so."""
    albedo = generator(1).uniform(0.5, 1, 256)
    matrix = (np.outer(albedo, albedo) + 0.02 * WEDGE)[:1]
    method, rays = get_method(name), RayDomain(SHAPE)
    options = options_of(method, target_error=1e-6)
    targeted: Method[Any] = method.with_options(options)
    start = state = targeted.start(rays, rays, 1, options)
    packs = []
    for _ in range(targeted.n_levels(rays, rays)):
        shown = targeted.schedule(state)
        other = state.following == "hierarchy" and state.inner.level == 4
        images = MatrixImages(matrix[:, ::-1] if other else matrix, SHAPE, shown)
        state = targeted.refine(state, images)
        packs.append(targeted.pack(state))
    assert state.inner.level == 5
    assert state.best.level < 5
    assert "no blocks are left" in caplog.text
    found = targeted.transport(state)
    assert last_estimate(found) == state.estimates[-1].error
    lowest = method.transport(state.inner)
    assert pictures_error(found, matrix) < pictures_error(lowest, matrix)
    packs = [Pack(each.arrays, json.loads(json.dumps(each.attributes))) for each in packs]
    restored = targeted.restore(start, packs)
    np.testing.assert_array_equal(dense(targeted.transport(restored)), dense(found))
    assert restored.rows == state.rows


@BOTH
def test_truncated_it_is_what_the_level_knew(name: str) -> None:
    method = get_method(name)
    targeted = method.with_options(options_of(method, target_error=0.01))
    found = run(name, WEDGE, target_error=0.01)
    assert [row["block_level"] for row in found.transport.level_rows] == [0, 0, 1, 2, 3, 4]
    for level, block_level in enumerate([0, 0, 1, 2, 3, 4]):
        plain = method.transport(found.states[-1].inner).truncate(block_level)
        cut = found.transport.truncate(level)
        np.testing.assert_array_equal(dense(cut), dense(plain))
        assert [row["level"] for row in cut.level_rows][: level + 1] == list(range(level + 1))
    assert targeted.known(found.states[3]).last_level == 4
    with pytest.raises(rfpipe.errors.InputError):
        found.transport.truncate(7)


@BOTH
@pytest.mark.parametrize("case", ["zero_transport", "one_row", "dark_channel", "photon_starved"])
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_hard_cases_end(name: str, case: str) -> None:
    scene = hard_cases()[case]()
    noise = rfpipe.CameraModel() if case in ("dark_channel", "photon_starved") else None
    rig = rfpipe.OperatorRig(scene, scene.shape, scene.shape, noise)
    result = rfpipe.acquire(rig, name, progress=False, target_error=0.01)
    plain = rfpipe.acquire(rig, name, progress=False, tolerance=0.003)
    assert np.isfinite(result.history["estimated_error"]).all()
    assert np.isfinite(result.transport.relight(np.ones(scene.shape))).all()
    if case == "zero_transport":
        assert result.patterns == 1 + len(HELD_OUT)
        assert not result.transport.relight(np.ones(scene.shape)).any()
    assert len(HELD_OUT) < result.patterns <= 1.2 * plain.patterns + len(HELD_OUT)
