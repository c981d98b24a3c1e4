"""Optical low rank: the range of T from pictures under random signs."""

from pathlib import Path

import numpy as np
import pytest
from tests.helpers import MatrixImages, acquire_matrix, dense

from rfpipe import OperatorRig, acquire
from rfpipe.blocks import RayDomain
from rfpipe.config import CameraConfig
from rfpipe.errors import InputError
from rfpipe.methods import options_of
from rfpipe.methods.rivals.low_rank import LowRank
from rfpipe.scenes import reference_scene
from rfpipe.store.arrays import open_arrays, write_arrays
from rfpipe.testing import dot_test
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.low_rank import LowRankTransport


def of_rank(rank: int, rays: int = 256, seed: int = 0) -> np.ndarray:
    factors = np.random.default_rng(seed).random((rank, rays))
    return factors.T @ factors / rays


def relative(found: np.ndarray, matrix: np.ndarray) -> float:
    return float(np.linalg.norm(found - matrix) / np.linalg.norm(matrix))


@pytest.mark.parametrize("diagonal", [0.0, 1.0])
def test_rank_5_and_a_diagonal_are_recovered_exactly(diagonal: float) -> None:
    matrix = of_rank(5) + diagonal * np.diag(np.random.default_rng(1).random(256))
    run = acquire_matrix(LowRank(), matrix, (16, 16), (16, 16))
    assert sum(run.patterns) <= 65
    assert relative(dense(run.transport)[0], matrix) < 1e-5
    assert run.patterns[:3] == [1, 16, 16]


def test_patterns_are_weights_of_light_and_no_two_levels_share_one() -> None:
    run = acquire_matrix(LowRank(), of_rank(40), (16, 16), (16, 16))
    shown = np.concatenate([one.batch(0, one.count) for one in run.schedules]).reshape(-1, 256)
    assert set(np.unique(shown)) == {0, 1}
    assert len(np.unique(shown, axis=0)) == len(shown) == sum(run.patterns)


def test_a_diagonal_alone_ends_after_the_first_round() -> None:
    matrix = np.diag(np.random.default_rng(2).random(256))
    run = acquire_matrix(LowRank(), matrix, (16, 16), (16, 16))
    assert run.patterns == [1, 16, 0, 0, 0, 0]
    assert relative(dense(run.transport)[0], matrix) < 1e-6


def test_no_terms_are_made_of_noise() -> None:
    matrix = 0.5 * (of_rank(3) + np.eye(256))
    rig = OperatorRig(matrix, (16, 16), (16, 16), CameraConfig())
    result = acquire(rig, "low_rank", progress=False, target_error=1e-6)
    assert result.patterns == 257
    assert result.transport.rank <= 5
    assert relative(dense(result.transport)[0], matrix) < 5e-3


def test_the_number_of_patterns_is_a_limit_that_holds() -> None:
    rig = OperatorRig(of_rank(100), (16, 16), (16, 16))
    exact = acquire(rig, "low_rank", progress=False, patterns=41, target_error=1e-6)
    assert exact.patterns == 41
    assert exact.levels["patterns"].tolist() == [1, 16, 16, 8, 0, 0]
    more = acquire(rig, "low_rank", progress=False, patterns=129, target_error=1e-6)
    matrix = of_rank(100)
    errors = [relative(dense(one.transport)[0], matrix) for one in (exact, more)]
    assert errors[1] < 0.9 * errors[0]


def test_a_coarser_target_takes_fewer_patterns() -> None:
    scene = reference_scene("IV", (16, 16), channels=1)
    rig = OperatorRig(scene.dense(0), (16, 16), (16, 16))
    counts = [
        acquire(rig, "low_rank", progress=False, target_error=target).patterns
        for target in (0.1, 1e-3)
    ]
    assert counts[0] < counts[1]


def test_the_held_out_estimate_is_the_error_on_patterns_not_yet_seen() -> None:
    matrix = of_rank(60) + np.eye(256)
    method, domain = LowRank(), RayDomain((16, 16))
    state = method.start(domain, domain, 1, options_of(method, target_error=1e-6))
    for _ in range(3):
        before = dense(method.transport(state))[0] if state.level else None
        schedule = method.schedule(state)
        state = method.refine(state, MatrixImages(matrix[None], (16, 16), schedule))
    signs = 2 * schedule.batch(0, 16).reshape(16, -1) - 1
    true = np.linalg.norm((before - matrix) @ signs.T) / np.linalg.norm(matrix @ signs.T)
    assert state.rows[-1]["estimated_error"] == pytest.approx(true, rel=1e-3)


def test_colours_may_differ_in_rank_and_one_may_be_dark() -> None:
    matrix = np.stack([of_rank(6), of_rank(1), np.zeros((256, 256))])
    run = acquire_matrix(LowRank(), matrix, (16, 16), (16, 16))
    np.testing.assert_allclose(dense(run.transport), matrix, atol=1e-4 * matrix.max())
    assert not run.transport.relight(np.ones((16, 16)))[..., 2].any()


@pytest.mark.parametrize("shape", [(1, 1), (1, 3), (5, 1), (1, 37), (2, 3, 4)])
def test_small_domains_of_any_shape(shape: tuple[int, ...]) -> None:
    rays = RayDomain(shape).size
    matrix = of_rank(1, rays) + np.eye(rays)
    run = acquire_matrix(LowRank(), matrix, shape, shape)
    ones = np.ones(shape)
    expected = matrix.sum(axis=1).reshape(*shape, 1)
    np.testing.assert_allclose(run.transport.relight(ones), expected, rtol=1e-4)


def test_a_noisy_scene_is_relit_better_than_by_direct_light_alone() -> None:
    scene = reference_scene("II", (16, 16), channels=1).dense(0)
    rig = OperatorRig(scene, (16, 16), (16, 16), CameraConfig())
    result = acquire(rig, "low_rank", progress=False)
    pattern = np.zeros((16, 16))
    pattern[:, 3:5] = 1
    truth = scene @ pattern.ravel()
    direct = np.diag(scene) * pattern.ravel()
    relit = result.transport.relight(pattern).ravel()
    assert np.linalg.norm(relit - truth) < 0.5 * np.linalg.norm(direct - truth)


def test_states_go_through_a_store_at_every_level(tmp_path: Path) -> None:
    method = LowRank()
    run = acquire_matrix(method, of_rank(60), (16, 16), (16, 16))
    assert method.restore(run.states[0], []) is run.states[0]
    packs = []
    for level, pack in enumerate(run.packs):
        write_arrays(tmp_path / f"{level}.zarr", dict(pack.arrays), {"state": pack.attributes})
        bundle = open_arrays(tmp_path / f"{level}.zarr")
        arrays = {name: bundle.read(name) for name in bundle.names}
        packs.append(type(pack)(arrays, bundle.attributes["state"]))
        restored = method.restore(run.states[0], packs)
        after = run.states[level + 1]
        if after.level < len(run.packs):
            again, expected = method.schedule(restored), method.schedule(after)
            np.testing.assert_array_equal(again.weights, expected.weights)
        assert (restored.done, restored.shown) == (after.done, after.shown)
        assert restored.rows == after.rows
        np.testing.assert_array_equal(
            dense(method.transport(restored)), dense(method.transport(after))
        )


def test_transports_are_stored_and_their_transposes_belong_to_them(tmp_path: Path) -> None:
    run = acquire_matrix(LowRank(), of_rank(6) + np.eye(256), (16, 16), (16, 16))
    dot_test(run.transport)
    save_transport(run.transport, tmp_path / "transport.zarr", "uint8")
    stored = open_transport(tmp_path / "transport.zarr")
    np.testing.assert_array_equal(dense(stored), dense(run.transport))
    assert stored.level_rows == run.transport.level_rows
    assert stored.nbytes > 0
    assert run.transport.nbytes < 256 * 256 * 4 / 2


def test_terms_of_two_domains() -> None:
    random = np.random.default_rng(4)
    left, right = random.random((3, 2, 6)), random.random((3, 2, 20))
    strengths = random.random((3, 2)) - 0.5
    arrays = {
        "left": left.astype(np.float32),
        "right": right.astype(np.float32),
        "strengths": strengths.astype(np.float32),
    }
    transport = LowRankTransport((2, 3), (4, 5), 3, [], arrays)
    expected = np.einsum("cr,crm,crn->cmn", strengths, left, right)
    np.testing.assert_allclose(dense(transport), expected, atol=1e-6)
    dot_test(transport)
    del arrays["right"]
    with pytest.raises(InputError, match="it needs one domain"):
        LowRankTransport((2, 3), (4, 5), 3, [], arrays)


def test_another_rig_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"coaxial rig.*\(2, 3\).*\(4, 5\); use a method for any rig"
    ):
        LowRank().n_levels(RayDomain((2, 3)), RayDomain((4, 5)))


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ({"target_error": 0.0}, "target_error is 0.0; it should be greater than 0"),
        ({"target_error": float("nan")}, "target_error is nan"),
        ({"patterns": -1}, "patterns is -1; it should be greater than or equal to 0"),
    ],
)
def test_impossible_wishes_are_refused(option: dict[str, float], expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        acquire(OperatorRig(np.eye(4), (2, 2), (2, 2)), "low_rank", progress=False, **option)
