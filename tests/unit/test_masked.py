"""Dead and hot pixels in every method: excluded, and filled in from the transpose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from tests.rigs.known_matrix import dense, scene_matrices

from rfpipe import OperatorRig, acquire
from rfpipe.config import CameraConfig
from rfpipe.rigs import Rig
from rfpipe.stages.acquire import AcquisitionResult
from rfpipe.stages.evaluate import relative_rms
from rfpipe.transport import Transport

pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

SIDE = 12
SHAPE = (SIDE, SIDE)
HOT, DEAD = [(3, 4), (8, 11)], [(3, 8), (10, 7)]
BAD = np.zeros(SHAPE, np.bool_)
BAD[tuple(np.transpose(HOT + DEAD))] = True
# half of the rays at random, an edge of light, and full light
LIT = np.random.default_rng(2).integers(0, 2, (6, *SHAPE)).astype(np.float32)
LIT[4] = np.arange(SIDE) < SIDE // 2
LIT[5] = 1
ROWS = ("brute_force", "hadamard", "dual")
SYMMETRIC = ("symmetric", "near_far")


@dataclass
class BadPixels:
    """A rig with stuck pixels: hot ones at high counts, dead ones at the black level."""

    rig: Rig
    hot: list[tuple[int, int]]
    dead: list[tuple[int, int]]

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rig, name)

    def capture(self, patterns: Any, keys: Any) -> Any:
        frames = self.rig.capture(patterns, keys)
        for pixels, count in ((self.hot, 3000), (self.dead, 65)):
            for row, column in pixels:
                frames[..., row, column, :] = count
        return frames


def matrix_iv() -> np.ndarray:
    return scene_matrices("IV", SHAPE)[0]


def rig_of(matrix: np.ndarray) -> OperatorRig:
    return OperatorRig(matrix, SHAPE, SHAPE, CameraConfig())


def pictures(transport: Transport) -> np.ndarray:
    return transport.relight_batch(LIT)[..., 0]


def error(result: AcquisitionResult, matrix: np.ndarray) -> float:
    """Return the mean relighting error of the good pixels."""
    truth = (LIT.reshape(6, -1) @ matrix.T).reshape(LIT.shape)
    pairs = zip(pictures(result.transport), truth, strict=True)
    return float(np.mean([relative_rms(relit[~BAD], true[~BAD]) for relit, true in pairs]))


@pytest.mark.parametrize("method", [*ROWS, *SYMMETRIC])
def test_defects_affect_only_their_pixels_and_are_filled_in(method: str) -> None:
    matrix = matrix_iv()
    good = acquire(rig_of(matrix), method, progress=False)
    bad = acquire(BadPixels(rig_of(matrix), HOT, DEAD), method, progress=False)
    assert not good.masked.any()
    np.testing.assert_array_equal(bad.masked, BAD)
    if method == "near_far":  # its error estimate may require one more round
        assert len(bad.history) <= len(good.history) + 1
    else:
        assert bad.patterns <= 1.5 * good.patterns
    assert error(bad, matrix) < 1.25 * error(good, matrix)
    assert sum(row["patterns"] for row in bad.transport.level_rows) == bad.patterns
    estimate, mask = dense(bad.transport)[0], BAD.ravel()
    assert np.isfinite(estimate).all()
    rows, columns = estimate[np.ix_(mask, ~mask)], estimate[np.ix_(~mask, mask)].T
    if method == "dual":  # each response is distributed by the light of other pixels
        assert np.linalg.norm(rows - columns) < 0.1 * np.linalg.norm(columns)
        assert relative_rms(rows, matrix[np.ix_(mask, ~mask)]) < 0.1
    else:
        np.testing.assert_allclose(rows, columns, atol=1e-6 * np.abs(estimate).max())
    assert 0.5 < rows.sum() / matrix[np.ix_(mask, ~mask)].sum() < 2
    # transport between bad pixels is unknown and remains 0
    assert np.diag(estimate)[mask].max() < 0.01 * np.median(np.diag(matrix))
    assert np.isfinite(bad.history["estimated_error"]).all()


def test_unknown_pixels_do_not_count_as_error() -> None:
    rig = BadPixels(rig_of(matrix_iv()), HOT, DEAD)
    result = acquire(rig, "near_far", target_error=0.01, progress=False)
    np.testing.assert_array_equal(result.masked, BAD)
    assert 0 < result.history["estimated_error"].iloc[-1] < 0.01


@pytest.mark.parametrize("method", ["dual", "symmetric"])
def test_pixels_that_see_empty_space_are_not_masked(method: str) -> None:
    matrix = matrix_iv()
    empty = np.ravel_multi_index(np.transpose([(5, 5), (9, 2), (9, 3)]), SHAPE)
    matrix[empty] = matrix[:, empty] = 0
    result = acquire(rig_of(matrix), method, progress=False)
    assert not result.masked.any()
    plain = acquire(rig_of(matrix), method, progress=False, mask_defects=False)
    np.testing.assert_array_equal(pictures(result.transport), pictures(plain.transport))


def test_defects_of_a_noncoaxial_rig_are_not_filled_in() -> None:
    matrix = matrix_iv()[:, np.random.default_rng(0).permutation(SIDE**2)]
    result = acquire(BadPixels(rig_of(matrix), HOT, DEAD), "brute_force", progress=False)
    estimate = dense(result.transport)[0]
    assert not estimate[BAD.ravel()].any()
    assert relative_rms(estimate[~BAD.ravel()], matrix[~BAD.ravel()]) < 0.01


def test_a_mosaic_masks_the_neighbours_of_a_hot_photosite() -> None:
    rig = OperatorRig(scene_matrices("IV", (8, 8), 3), (8, 8), (8, 8), CameraConfig(bayer="RGGB"))

    class HotPhotosite(BadPixels):
        def capture(self, patterns: Any, keys: Any) -> Any:
            frames = self.rig.capture(patterns, keys)
            frames[..., 5, 6] = 3000
            return frames

    # one ray per photosite: interpolated photosites have no symmetric transport
    options = {"symmetry_brackets": 0, "progress": False}
    result = acquire(HotPhotosite(rig, [], []), "symmetric", **options)
    assert result.masked.sum() == 9
    assert np.isfinite(dense(result.transport)).all()


def test_a_noise_significance_of_0_gives_finite_transport() -> None:
    matrix = matrix_iv()
    rig = BadPixels(rig_of(matrix), HOT, DEAD)
    for method in ("dual", "symmetric"):
        result = acquire(rig, method, progress=False, noise_significance=0.0)
        assert np.isfinite(dense(result.transport)).all()


def test_a_corner_of_the_image_may_be_unknown() -> None:
    matrix = matrix_iv()
    corner = [(row, column) for row in range(4) for column in range(4)]
    result = acquire(BadPixels(rig_of(matrix), corner, []), "symmetric", progress=False)
    assert result.masked.sum() == 16
    mask = result.masked.ravel()
    estimate = dense(result.transport)[0]
    assert np.isfinite(estimate).all()
    assert relative_rms(estimate[~mask][:, ~mask], matrix[~mask][:, ~mask]) < 0.02
