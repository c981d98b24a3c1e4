"""A transport as a matrix: products, entries, coarser rays, and rejected arguments."""

import numpy as np
import pytest
from tests.unit.test_transports import N, leaves, scan

import rfpipe
from rfpipe.errors import InputError
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.regrouping import cell_sums
from rfpipe.transport.sum import SumTransport

RANDOM = np.random.default_rng(3)


BOTH = pytest.mark.parametrize("make", [scan, leaves])


@BOTH
@pytest.mark.parametrize("rows", [None, [3], [5, 1], slice(2, 9, 3)])
@pytest.mark.parametrize("columns", [None, [23, 0], slice(0, 24)])
def test_selected_rows_and_columns_equal_the_matrix(make, rows, columns) -> None:
    transport, matrix = make()
    chosen = matrix[:, slice(None) if rows is None else rows]
    chosen = chosen[:, :, slice(None) if columns is None else columns]
    np.testing.assert_allclose(transport.toarray(rows, columns), chosen, rtol=1e-5, atol=1e-4)


@BOTH
@pytest.mark.parametrize("dual", [False, True])
@pytest.mark.parametrize("shape", [(), (1,), (4,), (1, 4), (3, 4)])
def test_products_equal_those_of_numpy(make, dual: bool, shape: tuple[int, ...]) -> None:
    transport, matrix = make()
    lit = transport.T if dual else transport
    matrix = matrix.swapaxes(1, 2) if dual else matrix
    channels, *count = (None, *shape) if len(shape) < 2 else shape
    leading = () if channels is None else (channels,)
    x = RANDOM.random((*leading, matrix.shape[2], *count), dtype=np.float32)
    np.testing.assert_allclose(lit @ x, matrix @ x, rtol=1e-5, atol=1e-4)
    y = RANDOM.random((*leading, *count, matrix.shape[1]), dtype=np.float32)
    np.testing.assert_allclose(y @ lit, y @ matrix, rtol=1e-5, atol=1e-4)
    assert (lit @ x).dtype == (y @ lit).dtype == np.float32


def test_products_reject_values_that_are_not_finite_numbers() -> None:
    transport, _ = scan()
    with pytest.raises(InputError, match="NaN"):
        transport @ np.full(N, np.nan)
    with pytest.raises(InputError, match="complex128"):
        transport @ np.ones(N, complex)


@pytest.mark.parametrize("rows", [[15], [], slice(9, 2), [0.5], np.ones((5, 5), bool)])
def test_missing_rays_are_rejected(rows) -> None:
    with pytest.raises(InputError, match="rows: "):
        scan()[0].toarray(rows=rows)


def test_a_huge_matrix_is_rejected_before_it_is_computed() -> None:
    shape = (310, 350)
    transport = SumTransport([_Nothing(shape)], [])
    with pytest.raises(InputError, match=r"3 x 108,500 x 108,500 entries takes 131\.6 GiB"):
        transport.toarray()
    with pytest.raises(InputError, match=r"choose rows or columns.*rfpipe\.coarser\(T, 4\)"):
        np.asarray(transport)
    assert transport.toarray(rows=[5]).shape == (3, 1, 108_500)


class _Nothing(DenseTransport):
    """A transport too large for memory, without arrays."""

    def __init__(self, shape: tuple[int, int]) -> None:
        super().__init__(shape, shape, 3, [], {})

    def forward(self, patterns, channels):
        return np.zeros((len(patterns), len(channels), 108_500), np.float32)

    adjoint = forward


def test_cells_of_rays_do_not_cross_views() -> None:
    grid, sums = cell_sums((2, 3, 5), 2)
    assert grid == (2, 2, 3)
    image = np.arange(30.0).reshape(2, 3, 5)
    result = (sums @ image.ravel()).reshape(grid)
    assert result[1, 0, 1] == image[1, :2, 2:4].sum()
    assert result[0, 1, 2] == image[0, 2, 4]


@BOTH
@pytest.mark.parametrize("factor", [1, 2, 3, 100])
def test_coarser_rays_average_the_image_and_repeat_the_pattern(make, factor: int) -> None:
    transport, matrix = make()
    coarse = rfpipe.coarser(transport, factor)
    mean, repeat = (
        cell_sums(shape, factor)[1].toarray()
        for shape in (transport.camera_shape, transport.projector_shape)
    )
    expected = mean / mean.sum(axis=1, keepdims=True) @ matrix @ repeat.T
    made = np.asarray(coarse)
    assert (coarse.shape, coarse.ndim, coarse.dtype) == (made.shape, made.ndim, made.dtype)
    np.testing.assert_allclose(made, expected, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(coarse.T.toarray(), expected.swapaxes(1, 2), rtol=1e-5, atol=1e-4)
    pattern = RANDOM.random(coarse.projector_shape, dtype=np.float32)
    image = coarse.relight(pattern)
    assert image.shape == (*coarse.camera_shape, 3)
    np.testing.assert_allclose(
        image.reshape(-1, 3).T, expected @ pattern.ravel(), rtol=1e-5, atol=1e-4
    )
