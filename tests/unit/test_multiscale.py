"""Smooth basis functions of several scales, and their pairs."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.transport.multiscale import (
    REACH,
    MultiscaleBasis,
    cells,
    functions_over,
)

SHAPES = [(1, 1), (1, 37), (13, 29), (12, 10), (2, 3, 5)]


def some_functions(shape: tuple[int, ...]) -> np.ndarray:
    """Return all functions of scale 4, and functions of scales 2 and 1 in the first cells."""
    parts = [functions_over(4, np.ones(cells(shape, 4), np.bool_))]
    for scale in (2, 1):
        covered = np.zeros(cells(shape, scale), np.bool_)
        covered[0, :2, :2] = True
        parts.append(functions_over(scale, covered))
    return np.concatenate(parts)


def spline(distance: float) -> float:
    """Return the quadratic B-spline of unit spacing, by its definition."""
    distance = abs(distance)
    if distance <= 0.5:
        return 0.75 - distance**2
    return (1.5 - distance) ** 2 / 2 if distance < 1.5 else 0.0


def weight_of(scale: int, row: int, column: int, y: int, x: int) -> float:
    """Return the value of a function at the pixel (y, x), by its definition."""
    if scale == 1:
        return float((y, x) == (row, column))
    down, across = (y + 0.5) / scale - (row - 0.5), (x + 0.5) / scale - (column - 0.5)
    return spline(down) * spline(across)


@pytest.mark.parametrize("shape", SHAPES)
def test_weights_are_b_splines_about_the_centres(shape: tuple[int, ...]) -> None:
    basis = MultiscaleBasis(shape, some_functions(shape))
    expected = np.zeros((int(np.prod(shape)), len(basis)))
    height, width = shape[-2:]
    for index, (scale, view, row, column) in enumerate(basis.functions.tolist()):
        for y, x in np.ndindex(height, width):
            value = weight_of(scale, row, column, y, x)
            expected[(view * height + y) * width + x, index] = value
    np.testing.assert_allclose(basis.weights.toarray(), expected, atol=1e-6)
    np.testing.assert_array_equal(basis.sums.toarray(), basis.weights.toarray().T)
    assert basis.weights.dtype == basis.sums.dtype == np.float32


def test_functions_of_a_scale_cover_the_selected_cells() -> None:
    covered = np.zeros(cells((12, 16), 4), np.bool_)
    assert covered.shape == (1, 3, 4)
    covered[0, 1, 2] = True
    fine = functions_over(4, covered)
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
def test_pairs_are_all_functions_within_reach_once(shape: tuple[int, ...]) -> None:
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
