"""Rows of a transport taken from its columns."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.filling import fill_from_transpose
from rfpipe.transport.low_rank import LowRankTransport

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


def of_matrix(matrix: np.ndarray, shape: tuple[int, ...] = SHAPE) -> DenseTransport:
    rows = [{"level": 0, "patterns": RAYS}]
    return DenseTransport(shape, SHAPE, len(matrix), rows, {"matrix": matrix})


@pytest.mark.parametrize(
    "kind",
    ["nothing masked", "another domain", "not symmetric", "filled", "neither row nor column"],
)
def test_transports_that_cannot_be_filled_are_not_changed(kind: str) -> None:
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
