"""Hadamard multiplexing: brute force with half of the projector lit in every pattern.

Y. Y. Schechner, S. K. Nayar and P. N. Belhumeur, *Multiplexing for optimal lighting*, PAMI 29
(2007); M. Harwit and N. J. A. Sloane, *Hadamard transform optics*, 1979.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, Forecast, LevelImages, Options
from rfpipe.methods.brute_force import BruteForce, ScanState, read_columns
from rfpipe.methods.images import batches
from rfpipe.methods.states import level_row
from rfpipe.patterns import Schedule


class Hadamard(BruteForce):
    """A scan of the projector's rays by the rows of an S-matrix.

    Of all sets of n patterns of on and off for n unknowns, an S-matrix has the least noise where
    noise is the same in every picture: each entry of ``T`` has ``4 n / (n + 1)^2`` of a picture's
    variance, against 1 by brute force. Pure photon noise gives about twice the mean variance of
    brute force. Negative entries stay, since clamping would bias relit pictures.
    """

    name = "hadamard"
    title = "Hadamard multiplexing"
    colour = "#7d5ba6"
    marker = "^"
    line = "-"

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Options
    ) -> Forecast:
        """Forecast as many patterns as the order of the S-matrix."""
        order = s_matrix_order(projector.size)
        return self.forecast_of(camera, channels, order, order)

    def next_schedule(self, state: ScanState) -> Schedule | None:
        """Light about half of the rays in each pattern, the next pattern's shifted by one ray."""
        if state.rows:
            return None
        rays = state.projector.size
        code = s_matrix_row(s_matrix_order(rays)).astype(np.float32)
        shifted = np.lib.stride_tricks.sliding_window_view(np.append(code, code[: rays - 1]), rays)
        weights = shifted.reshape(-1, *state.projector.shape)
        return Schedule(0, state.projector.shape, len(code), weights=weights)

    def refine(
        self, state: ScanState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> ScanState:
        """Solve for the matrix."""
        channels, pixels, rays = state.matrix.shape
        order = images.schedule.count
        coded = read_columns(images, channels, pixels)
        matrix = decode(coded.reshape(-1, order), rays).reshape(state.matrix.shape)
        row = level_row(0, order, nodes=pixels * rays, scalar=pixels * rays)
        return replace(state, matrix=matrix, rows=(row,))


def s_matrix_order(rays: int) -> int:
    """Return the least order, at least `rays`, of an S-matrix made from quadratic residues.

    That is 1 or a prime of the form 4 k + 3; columns beyond the rays are left out. Powers of two,
    the orders of Hadamard's matrices by Sylvester, would take up to twice the patterns.
    """

    def is_prime(number: int) -> bool:
        return all(number % divisor for divisor in range(2, isqrt(number) + 1))

    if rays == 1:
        return 1
    return next(order for order in count(rays + (3 - rays) % 4, 4) if is_prime(order))


def s_matrix_row(order: int) -> NDArray[np.uint8]:
    """Return the first row of a cyclic S-matrix, 0 or 1, of an order from `s_matrix_order`.

    Row i has the ones where i + j is 0 or a square modulo the order, (order + 1) / 2 of them.
    """
    code = np.zeros(order, np.uint8)
    code[np.square(np.arange(order, dtype=np.int64)) % order] = 1
    return code


def decode(coded: NDArray[Any], rays: int) -> Float:
    """Solve ``S x = c`` for many c, (pixels, n), float32 (pixels, rays).

    ``S^-1 = 2 (2 S^T - J) / (n + 1)``; S is circulant, so that its product is a correlation.
    """
    from scipy import fft

    order = coded.shape[1]
    inverse = fft.rfft(4.0 / (order + 1) * s_matrix_row(order) - 2.0 / (order + 1))
    transport = np.empty((len(coded), rays), np.float32)
    for first, last in batches(len(coded), 4 * order):  # complex128
        spectrum = fft.rfft(coded[first:last].astype(np.float64), axis=1)
        transport[first:last] = fft.irfft(inverse * spectrum.conj(), order, axis=1)[:, :rays]
    return transport
