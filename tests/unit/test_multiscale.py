"""Smooth functions of many scales, their pairs, and the transport that they exchange."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from tests.helpers import dense

from rfpipe.testing import dot_test
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multiscale import (
    REACH,
    MultiscaleBasis,
    MultiscaleTransport,
    cells,
    functions_over,
)
from rfpipe.transport.sum import SumTransport

ROWS = [{"level": level, "patterns": 3} for level in range(4)]
SHAPES = [(1, 1), (1, 37), (13, 29), (12, 10), (2, 3, 5)]


def every_function(shape: tuple[int, ...], scales: list[int]) -> np.ndarray:
    return np.concatenate(
        [functions_over(scale, np.ones(cells(shape, scale), np.bool_)) for scale in scales]
    )


def some_functions(shape: tuple[int, ...]) -> np.ndarray:
    """All of scale 4, and of 2 and 1 those of the first cells."""
    parts = [every_function(shape, [4])]
    for scale in (2, 1):
        wanted = np.zeros(cells(shape, scale), np.bool_)
        wanted[0, :2, :2] = True
        parts.append(functions_over(scale, wanted))
    return np.concatenate(parts)


def made(shape: tuple[int, ...], channels: int = 3, seed: int = 0) -> MultiscaleTransport:
    random = np.random.default_rng(seed)
    basis = MultiscaleBasis(shape, some_functions(shape))
    arrays = {
        "factor": random.random((channels, int(np.prod(shape)))).astype(np.float32),
        "functions": basis.functions,
        "cores": random.standard_normal((channels, len(basis.first))).astype(np.float32),
    }
    return MultiscaleTransport(shape, channels, ROWS, arrays)


def spline(distance: float) -> float:
    """The quadratic B-spline of unit spacing, by its definition."""
    distance = abs(distance)
    if distance <= 0.5:
        return 0.75 - distance**2
    return (1.5 - distance) ** 2 / 2 if distance < 1.5 else 0.0


def as_matrix(basis: MultiscaleBasis, cores: np.ndarray) -> np.ndarray:
    """S of one channel."""
    matrix = np.zeros((len(basis), len(basis)))
    for first, second, core in zip(basis.first, basis.second, cores, strict=True):
        matrix[first, second] = matrix[second, first] = core
    return matrix


@pytest.mark.parametrize("shape", SHAPES)
def test_weights_are_b_splines_about_the_centres(shape: tuple[int, ...]) -> None:
    basis = MultiscaleBasis(shape, some_functions(shape))
    expected = np.zeros((int(np.prod(shape)), len(basis)))
    height, width = shape[-2:]
    for index, (scale, view, row, column) in enumerate(basis.functions.tolist()):
        for y in range(height):
            for x in range(width):
                if scale == 1:
                    value = float((y, x) == (row, column))
                else:
                    down = (y + 0.5) / scale - (row - 0.5)
                    across = (x + 0.5) / scale - (column - 0.5)
                    value = spline(down) * spline(across)
                expected[(view * height + y) * width + x, index] = value
    np.testing.assert_allclose(basis.weights.toarray(), expected, atol=1e-6)
    np.testing.assert_array_equal(basis.sums.toarray(), basis.weights.toarray().T)
    assert basis.weights.dtype == basis.sums.dtype == np.float32


def test_functions_of_a_scale_come_where_they_are_wanted() -> None:
    wanted = np.zeros(cells((12, 16), 4), np.bool_)
    assert wanted.shape == (1, 3, 4)
    wanted[0, 1, 2] = True
    fine = functions_over(4, wanted)
    assert fine.dtype == np.int32
    basis = MultiscaleBasis((12, 16), fine)
    assert len(basis) == 9
    cover = basis.weights.toarray().sum(axis=1).reshape(12, 16)
    np.testing.assert_allclose(cover[4:8, 8:12], 1, atol=1e-6)
    assert (basis.weights.toarray().reshape(12, 16, 9)[4:8, 8:12].max(axis=(0, 1)) > 0).all()
    rays = functions_over(1, np.eye(3, dtype=np.bool_)[None])
    assert rays.tolist() == [[1, 0, 0, 0], [1, 0, 1, 1], [1, 0, 2, 2]]
    assert functions_over(2, np.zeros((1, 3, 3), np.bool_)).shape == (0, 4)


@pytest.mark.parametrize("shape", SHAPES)
def test_pairs_are_those_within_reach_each_once(shape: tuple[int, ...]) -> None:
    basis = MultiscaleBasis(shape, some_functions(shape))
    scale, view = basis.functions[:, :2].T
    expected = set()
    for a in range(len(basis)):
        for b in range(a, len(basis)):
            coarser = max(scale[a], scale[b])
            apart = np.abs(basis.centres[a] - basis.centres[b]).max()
            if coarser == 4:
                joined = view[a] == view[b] or scale[a] == scale[b]
            else:
                joined = view[a] == view[b] and apart <= REACH * coarser
            if joined:
                expected.add((a, b))
    pairs = list(zip(basis.first.tolist(), basis.second.tolist(), strict=True))
    assert len(pairs) == len(set(pairs))
    assert set(pairs) == expected
    assert basis.first.dtype == basis.second.dtype == np.int32


@pytest.mark.parametrize("shape", SHAPES)
def test_it_is_the_product_that_its_arrays_say(shape: tuple[int, ...]) -> None:
    transport = made(shape)
    basis, arrays = transport.basis, transport.pack()[0]
    weights = basis.weights.toarray().astype(np.float64)
    for channel, matrix in enumerate(dense(transport)):
        smooth = weights @ as_matrix(basis, arrays["cores"][channel]) @ weights.T
        factor = arrays["factor"][channel].astype(np.float64)
        expected = factor[:, None] * smooth * factor
        np.testing.assert_allclose(matrix, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("shape", SHAPES)
def test_light_between_few_patterns_is_that_of_the_matrix(shape: tuple[int, ...]) -> None:
    transport, rays = made(shape), int(np.prod(shape))
    random = np.random.default_rng(3)
    arrays = {
        "diagonal": random.random((3, rays)).astype(np.float32),
        "left": random.random((3, 2, rays)).astype(np.float32),
        "strengths": random.standard_normal((3, 2)).astype(np.float32),
    }
    direct = LowRankTransport(shape, shape, 3, ROWS, arrays)
    matrix = {"matrix": dense(direct).astype(np.float32)}
    summed = SumTransport([transport, direct, DenseTransport(shape, shape, 3, [], matrix)], [])
    received, sent = (csr_array(random.random((rays, n)).astype(np.float32)) for n in (3, 70))
    expected = received.toarray().T @ dense(summed)[1] @ sent.toarray()
    found = summed.between(received, sent, 1)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("shape", SHAPES)
def test_it_is_symmetric(shape: tuple[int, ...]) -> None:
    transport = made(shape)
    dot_test(transport)
    matrix = dense(transport)
    np.testing.assert_allclose(matrix, matrix.transpose(0, 2, 1), atol=1e-5 * np.abs(matrix).max())
    picture = np.random.default_rng(1).random(shape)
    np.testing.assert_array_equal(transport.T.relight(picture), transport.relight(picture))


def test_pairs_may_be_some_of_the_basis() -> None:
    whole = made((6, 7))
    arrays, _ = whole.pack()
    pairs = np.stack([whole.basis.first, whole.basis.second])
    parts = []
    for chosen in (np.arange(pairs.shape[1]) % 3 == 0, np.arange(pairs.shape[1]) % 3 != 0):
        own = arrays | {"pairs": pairs[:, chosen], "cores": arrays["cores"][:, chosen]}
        parts.append(MultiscaleTransport((6, 7), 3, [], own))
    expected = dense(whole)
    np.testing.assert_allclose(dense(parts[0]) + dense(parts[1]), expected, atol=1e-5)
    assert not np.allclose(dense(parts[0]), expected, atol=1e-2)


def test_a_sum_keeps_it_beside_other_parts(tmp_path: Path) -> None:
    direct = {
        "diagonal": np.random.default_rng(2).random((3, 42)).astype(np.float32),
        "left": np.zeros((3, 0, 42), np.float32),
        "strengths": np.zeros((3, 0), np.float32),
    }
    smooth = made((6, 7))
    parts = [LowRankTransport((6, 7), (6, 7), 3, [], direct), smooth]
    total = SumTransport(parts, ROWS)
    save_transport(total, tmp_path / "transport.zarr")
    stored = open_transport(tmp_path / "transport.zarr")
    assert isinstance(stored, SumTransport)
    np.testing.assert_array_equal(dense(stored), dense(total))
    diagonal = np.stack([np.diag(one) for one in direct["diagonal"]])
    scale = np.abs(dense(total)).max()
    np.testing.assert_allclose(dense(total) - diagonal, dense(smooth), atol=1e-6 * scale)
    assert total.nbytes == parts[0].nbytes + smooth.nbytes
