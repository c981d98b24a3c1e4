"""Rows of a transport taken from its columns."""

from __future__ import annotations

import numpy as np
import pytest
from tests.helpers import acquire_matrix, dense

from rfpipe.methods.dual import Dual
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.filling import fill_from_transpose
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multilevel import MultilevelTransport

SHAPE, RAYS = (5, 6), 30
MASK = np.zeros(SHAPE, np.bool_)
MASK[2, 3] = MASK[4, 5] = True


def symmetric(channels: int = 2) -> np.ndarray:
    half = np.random.default_rng(1).random((channels, RAYS, RAYS)).astype(np.float32)
    return half + half.transpose(0, 2, 1)


def without_rows(matrix: np.ndarray) -> np.ndarray:
    matrix = matrix.copy()
    matrix[:, MASK.ravel()] = 0
    return matrix


def filled(matrix: np.ndarray) -> np.ndarray:
    """What can be known: all but entries between masked rays."""
    matrix = matrix.copy()
    matrix[:, np.outer(MASK, MASK)] = 0
    return matrix


def of_matrix(matrix: np.ndarray, shape: tuple[int, ...] = SHAPE) -> DenseTransport:
    rows = [{"level": 0, "patterns": RAYS}]
    return DenseTransport(shape, SHAPE, len(matrix), rows, {"matrix": matrix})


def test_rows_of_a_dense_matrix(tmp_path) -> None:
    matrix = symmetric()
    found = fill_from_transpose(of_matrix(without_rows(matrix)), MASK)
    np.testing.assert_allclose(dense(found), filled(matrix), rtol=1e-6)
    assert found.level_rows == [{"level": 0, "patterns": RAYS}]
    save_transport(found, tmp_path / "transport.zarr")
    stored = open_transport(tmp_path / "transport.zarr")
    np.testing.assert_array_equal(dense(stored), dense(found))


def test_rows_of_dual_photography_stay_pairs() -> None:
    matrix = symmetric()
    found = acquire_matrix(Dual(), without_rows(matrix), SHAPE, SHAPE, 1e-9).transport
    assert not dense(found)[:, MASK.ravel()].any()
    found = fill_from_transpose(found, MASK)
    assert isinstance(found, MultilevelTransport)
    np.testing.assert_allclose(dense(found), filled(matrix), rtol=1e-4)
    finest = found.pair_sets[-1]
    order = finest.block.astype(np.int64) * RAYS + finest.pixel
    assert (np.diff(order) > 0).all()


@pytest.mark.parametrize(
    "kind",
    ["nothing masked", "another domain", "not symmetric", "filled", "neither row nor column"],
)
def test_nothing_to_fill(kind: str) -> None:
    mask, transport = MASK, of_matrix(without_rows(symmetric()))
    random = np.random.default_rng(1).random((1, RAYS, RAYS)).astype(np.float32)
    if kind == "nothing masked":
        mask = np.zeros_like(MASK)
    elif kind == "another domain":
        transport = of_matrix(np.zeros((1, 8, RAYS), np.float32), (2, 4))
        mask = np.ones((2, 4), np.bool_)
    elif kind == "not symmetric":
        transport = of_matrix(without_rows(random))
    elif kind == "filled":
        transport = of_matrix(symmetric())
    else:
        arrays = {"left": random[:, :2] * ~MASK.ravel(), "strengths": np.ones((1, 2), np.float32)}
        transport = LowRankTransport(SHAPE, SHAPE, 1, [], arrays)
    assert fill_from_transpose(transport, mask) is transport
