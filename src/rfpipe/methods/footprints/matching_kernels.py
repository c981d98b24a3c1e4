"""Compiled loops of `rfpipe.methods.footprints.matching`: averages over boxes, and the best box.

An image (H, W) of products has the product of a series with the whitened light of each projector
pixel. Its average over a box is the product of the series with the box.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from rfpipe.array_types import Double, Float, Index


class AxisAverages(NamedTuple):
    """Averages over boxes at half-pixel positions along an axis.

    Position ``2 k + parity`` is centred at ``k + (parity + 1) / 2`` pixels. Its box has the weights
    ``weights[parity]``, whose sum is 1, of the pixels from ``k + shift[parity]`` on. Light outside
    the image counts as 0: correlations don't depend on the sum of the weights.
    """

    shift: Index  # (2,)
    weights: Float  # (2, pixels of a box)


@njit(cache=True, nogil=True, fastmath=True)
def _average_rows(
    image: Float, averages: AxisAverages, position: int, origin: int, out: Float
) -> None:
    """Average the rows of an image (h, w) over the box at a position; writes to `out`, (w,).

    The first row has the number `origin`; rows that the image doesn't have are 0.
    """
    k, parity = position // 2, position % 2
    first = k + averages.shift[parity] - origin
    out[:] = 0
    for index in range(averages.weights.shape[1]):
        if 0 <= first + index < len(image):
            weight, row = averages.weights[parity, index], image[first + index]
            for x in range(len(out)):
                out[x] += weight * row[x]


@njit(cache=True, nogil=True)
def box_responses(image: Float, averages: AxisAverages, row: Index, column: Index) -> Float:
    """Average the patterns, an image (H, W, P), over the boxes at rows and columns (m,): (m, P)."""
    responses = np.empty((len(row), image.shape[2]), np.float32)
    lines = np.empty((averages.weights.shape[1], image.shape[2]), np.float32)
    for box in range(len(row)):
        first = row[box] // 2 + averages.shift[row[box] % 2]
        lines[:] = 0
        for index in range(len(lines)):
            if 0 <= first + index < len(image):
                _average_rows(image[first + index], averages, column[box], 0, lines[index])
        _average_rows(lines, averages, row[box], first, responses[box])
    return responses


@njit(cache=True, nogil=True, fastmath=True)
def box_lengths(image: Float, averages: AxisAverages) -> Float:
    """Compute the norm of the average of an image (H, W, P) over each box, (rows, 2, W).

    The box in column ``2 k + parity`` is at ``[row, parity, k]``; beyond the last column are zeros.
    """
    height, width, count = image.shape
    lengths = np.zeros((2 * height - 1, 2, width), np.float32)
    rows, response = image.reshape(height, -1), np.empty(count, np.float32)
    line = np.empty(width * count, np.float32)
    for row in range(len(lengths)):
        _average_rows(rows, averages, row, 0, line)
        for column in range(2 * width - 1):
            _average_rows(line.reshape(width, count), averages, column, 0, response)
            total = np.float32(0)
            for value in response:
                total += value * value
            lengths[row, column % 2, column // 2] = np.sqrt(total)
    return lengths


@njit(cache=True, nogil=True)
def match_all(
    products: Float, widths: tuple[AxisAverages, ...], scales: Float
) -> tuple[Index, Float]:
    """Find the box of highest correlation with each series.

    Parameters
    ----------
    products : ndarray of float32, shape (m, H, W)
        One image of products for each series.
    widths : tuple of AxisAverages
    scales : ndarray of float32, shape (widths, rows, 2, W)
        Factor of the product with each box, in the order of `box_lengths`.

    Returns
    -------
    boxes : ndarray of int64, shape (m,)
    correlation : ndarray of float32, shape (m,)
        0 for a series that no box resembles.
    """
    best, score = np.zeros(len(products), np.int64), np.zeros(len(products), np.float32)
    rows, columns = (0, scales.shape[1]), (0, 2 * scales.shape[3] - 1)
    for i in range(len(products)):
        best[i], score[i] = _best_of_window(products[i], (0, 0), widths, scales, rows, columns)
    return best, score


@njit(cache=True, nogil=True, fastmath=False)
def match_near(
    series: Float,
    image: Float,
    widths: tuple[AxisAverages, ...],
    scales: Float,
    guesses: Double,
    reach: float,
) -> tuple[Index, Float]:
    """Find the box of highest correlation with each series, among boxes near guessed places.

    Parameters
    ----------
    series : ndarray of float32, shape (m, P)
        Whitened, of length 1 each.
    image : ndarray of float32, shape (H, W, P)
        Whitened light of the projector's pixels.
    widths, scales
        As in `match_all`.
    guesses : ndarray of float64, shape (m, guesses, 2)
        Row and column in pixels; NaN for none. A box is compared if it is at most `reach` pixels
        from a guess along both axes. A guess within a pixel of an earlier one is skipped.
    reach : float

    Returns
    -------
    boxes, correlation
        As in `match_all`; 0 for a series without guesses.
    """
    best, score = np.zeros(len(series), np.int64), np.zeros(len(series), np.float32)
    for i in range(len(series)):
        for guess in range(guesses.shape[1]):
            row, column = guesses[i, guess]
            if np.isnan(row) or _is_repeated(guesses[i], guess):
                continue
            box, correlation = _best_near(series[i], image, widths, scales, row, column, reach)
            if correlation > score[i]:
                best[i], score[i] = box, correlation
    return best, score


@njit(cache=True, nogil=True)
def _is_repeated(guesses: Double, number: int) -> bool:
    """Test whether a guess is within a pixel of an earlier one, along both axes.

    `guesses` are those of a series, (guesses, 2).
    """
    for earlier in range(number):
        row, column = np.abs(guesses[earlier] - guesses[number])
        if row <= 1 and column <= 1:
            return True
    return False


@njit(cache=True, nogil=True)
def _best_near(
    series: Float,
    image: Float,
    widths: tuple[AxisAverages, ...],
    scales: Float,
    row: float,
    column: float,
    reach: float,
) -> tuple[int, np.float32]:
    """Find the box of highest correlation with one series near a place; 0 and 0 for none."""
    rows = _positions(row, reach, scales.shape[1])
    columns = _positions(column, reach, 2 * scales.shape[3] - 1)
    if rows[0] >= rows[1] or columns[0] >= columns[1]:
        return 0, np.float32(0)
    # boxes of the last width are the largest
    top, bottom = _pixels(widths[len(widths) - 1], rows, image.shape[0])
    first, end = _pixels(widths[len(widths) - 1], columns, image.shape[1])
    products = _products(series, image[top:bottom, first:end])
    return _best_of_window(products, (top, first), widths, scales, rows, columns)


@njit(cache=True, nogil=True)
def _positions(place: float, reach: float, count: int) -> tuple[int, int]:
    """Compute the half-open range of positions within reach of a place along an axis.

    The position of an index is ``(index + 1) / 2`` pixels.
    """
    first = max(0, int(np.ceil(2 * (place - reach) - 1)))
    return first, min(count, int(np.floor(2 * (place + reach) - 1)) + 1)


@njit(cache=True, nogil=True)
def _pixels(averages: AxisAverages, positions: tuple[int, int], length: int) -> tuple[int, int]:
    """Compute the half-open range of pixels of the boxes in a range of positions along an axis."""
    first = positions[0] // 2 + averages.shift[0]
    last = positions[1] // 2 + averages.shift[1] + averages.weights.shape[1]
    return max(first, 0), min(last, length)


@njit(cache=True, nogil=True, fastmath=True)
def _products(series: Float, image: Float) -> Float:
    """Multiply a series (P,) with the pixels of an image (h, w, P); returns (h, w)."""
    products = np.empty(image.shape[:2], np.float32)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            total = np.float32(0)
            for q in range(len(series)):
                total += series[q] * image[y, x, q]
            products[y, x] = total
    return products


@njit(cache=True, nogil=True, fastmath=True)
def _best_of_window(
    products: Float,
    origin: tuple[int, int],
    widths: tuple[AxisAverages, ...],
    scales: Float,
    rows: tuple[int, int],
    columns: tuple[int, int],
) -> tuple[int, np.float32]:
    """Find the box of largest correlation in half-open ranges of rows and columns.

    `products` (h, w) belong to pixels, the first of them at `origin`.
    """
    best, score = 0, np.float32(0)
    products_with_boxes = np.empty(scales.shape[3], np.float32)
    for width in range(len(widths)):
        averages = widths[width]
        margin = averages.weights.shape[1]
        line = np.zeros(products.shape[1] + 2 * margin, np.float32)
        for row in range(rows[0], rows[1]):
            _average_rows(products, averages, row, origin[0], line[margin:-margin])
            for parity in range(2):
                # columns 2 k + parity
                first, end = (columns[0] - parity + 1) // 2, (columns[1] - parity + 1) // 2
                factors = scales[width, row, parity, first:end]
                pixels = line[first + averages.shift[parity] - origin[1] + margin :]
                part = products_with_boxes[: end - first]
                k, correlation = _best_of_line(
                    pixels, averages.weights[parity], factors, score, part
                )
                if correlation > score:
                    column = 2 * (first + k) + parity
                    number = width * scales.shape[1] + row
                    best, score = number * (2 * scales.shape[3] - 1) + column, correlation
    return best, score


@njit(cache=True, nogil=True, fastmath=True)
def _best_of_line(
    pixels: Float, weights: Float, factors: Float, least: np.float32, products: Float
) -> tuple[int, np.float32]:
    """Find the box of largest product along a line, if one is above `least`.

    Box k has `weights` of the pixels from number k on. Returns the number of the box, and the
    product times its factor; 0 and `least` for none. Overwrites `products`, of one element a box.
    """
    count = len(factors)
    products[:] = 0
    for index in range(len(weights)):
        # of a slice, compiled code needn't test for negative indices
        line, weight = pixels[index : index + count], weights[index]
        for k in range(count):
            products[k] += weight * line[k]
    better = 0
    for k in range(count):
        products[k] *= factors[k]
        better += products[k] > least
    best, largest = 0, least
    if better:
        for k in range(count):
            if products[k] > largest:
                best, largest = k, products[k]
    return best, largest
