"""What cells exchange, given what a model leaves of pictures of them: the most probable, by scales.

K is ``W^T C W`` with Haar wavelets W; the entries of C are independent normal deviates, whose
variances are learned from the pictures.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.transport.wavelet import Group, Haar

_ROUNDING = float(np.finfo(np.float32).eps)
_TINY = float(np.finfo(np.float32).tiny)


class Posterior:
    """K of one channel given what a model leaves of pictures of cells, over F.

    Parameters
    ----------
    haar : Haar
        Of the camera's cells.
    light : ndarray of float32, shape (projector cells, P)
        Sums of the patterns times F.
    observed, variance : ndarray of float32, shape (cells, P)
        The variance is infinite where nothing is known.
    sender : tuple of Haar and ndarray, optional
        Of the projector's cells, and their `Sender.places`. Without one, K is symmetric.
    """

    def __init__(
        self,
        haar: Haar,
        light: Float,
        observed: Float,
        variance: Float,
        sender: tuple[Haar, Float] | None = None,
    ) -> None:
        self.haar, self.cells = haar, np.ascontiguousarray(light)
        self.symmetric = sender is None
        self.lamp = haar if sender is None else sender[0]
        self._places = None if sender is None else sender[1]
        self._known = np.isfinite(variance)
        self.observed = np.where(self._known, observed, 0)
        self._variance = np.where(self._known, variance, 0)
        certainty = np.divide(
            1, self._variance, where=self._known, out=np.zeros_like(self.observed)
        )
        self._noise = 1 / max(float(certainty.mean(dtype=np.float64)), _TINY)
        self.light = self.lamp.forward(self.cells)
        lit = max(float(np.square(self.cells, dtype=np.float64).mean()), _TINY)
        # variance of what cells send back directly: a part of that of what the model leaves
        self._direct = np.float32(0.02 * self.observed.var(dtype=np.float64) / lit)
        self._alike = [rows for group in haar.groups for rows in group.alike()]

    def left(self, matrix: Float, direct: Float) -> Float:
        """Return what K, and direct light, leave of the pictures (cells, P); 0 if unknown."""
        predicted = matrix @ self.cells
        if self.symmetric:
            predicted += direct[:, None] * self.cells
        residual: Float = np.where(self._known, self.observed - predicted, 0)
        return residual

    def _pairs(self) -> Iterator[tuple[Group, Group]]:
        """Yield each pair of scales, once where K is symmetric."""
        for index, one in enumerate(self.haar.groups):
            for other in self.lamp.groups[index if self.symmetric else 0 :]:
                yield one, other

    def _distances(self, one: Group, other: Group) -> Float:
        """Distances of places in cells, whichever views they are in, (places, places)."""
        centres = other.centres()
        if self._places is not None:
            _, height, width = self.lamp.stack
            cell = np.minimum(centres.astype(np.int64), (height - 1, width - 1))
            views = np.repeat(np.arange(other.grid[0]), other.grid[1] * other.grid[2])
            centres = self._places[(views * height + cell[:, 0]) * width + cell[:, 1]]
        apart = one.centres()[:, None] - centres
        distance: Float = np.hypot(apart[..., 0], apart[..., 1])
        return distance

    def _spread(self, variance: Float, one: Group, other: Group, each: Float) -> None:
        """Write the variances of pairs of places for all orientations."""
        if one is other:
            each = np.float32(0.5) * (each + each.T)
        shape = (one.orientations, one.places, other.orientations, other.places)
        whole = np.broadcast_to(each[None, :, None], shape).reshape(
            one.orientations * one.places, other.orientations * other.places
        )
        variance[one.rows, other.rows] = whole
        if self.symmetric and one is not other:
            variance[other.rows, one.rows] = whole.T

    def guessed(self) -> Float:
        """Return variances of C before any fit, (size, size): falling with the distance's square.

        The unit of distance is half a cell.
        """
        changing = self.light - self.light.mean(axis=1, keepdims=True)
        unit = np.square(changing, dtype=np.float64).sum(axis=0).mean() / len(changing)
        energy = np.square(self.observed, dtype=np.float64).sum(axis=0).mean()
        variance = np.empty((self.haar.size, self.lamp.size), np.float32)
        for one, other in self._pairs():
            apart = 1 + np.square(self._distances(one, other) / 0.5)
            each = (one.side * other.side) ** 2 / apart
            self._spread(variance, one, other, each.astype(np.float32))
        total = float(energy / max(unit, _TINY))
        variance *= np.float32(total / variance.sum(dtype=np.float64))
        return variance

    def prepare(self, prior: Float, times: int = 1) -> None:
        """Take a prior (size, size), and pictures whose variances are some times larger."""
        self.prior, self._times = prior, np.float32(times)
        self._core = np.zeros_like(prior)
        count = self.light.shape[1]
        self._roots = np.empty((len(self._alike), count, count), np.float32)
        self._inverses = np.empty_like(self._roots)
        for index, rows in enumerate(self._alike):
            scaled = self.light * np.sqrt(prior[rows].mean(axis=0))[:, None]
            # of a matrix and its own transpose, BLAS finds one half
            covariance = (scaled.T @ scaled).astype(np.float64)
            # float32 sums of much brighter light round more than that
            rounding = _ROUNDING * count * float(covariance.diagonal().max())
            covariance[np.diag_indices(count)] += times * self._noise + rounding
            root = np.linalg.inv(np.linalg.cholesky(covariance)).astype(np.float32)
            self._roots[index], self._inverses[index] = root, root.T @ root

    def relearned(self) -> Float:
        """Return the variances of C that its last solution, and its uncertainty, suggest.

        Those of a pair of places are averaged over orientations and with their neighbours', and
        drawn towards the mean of all pairs of the same two scales at about the same distance.
        """
        from scipy.ndimage import uniform_filter

        energy = np.empty_like(self.prior)
        for root, rows in zip(self._roots, self._alike, strict=True):
            energy[rows] = np.square(root @ self.light.T).sum(axis=0)
        # rows tell of an entry, and so do columns: either leaves a part of its variance, at least
        # a ten-thousandth, and certainties add up
        certainty = 1 / (self.prior * np.maximum(1 - self.prior * energy, np.float32(1e-4)))
        if self.symmetric:
            before = 1 / self.prior
            certainty = np.maximum(certainty + certainty.T - before, before)
        energy = np.square(self.core) + 1 / certainty
        variance = np.empty_like(energy)
        for one, other in self._pairs():
            part = energy[one.rows, other.rows].reshape(
                one.orientations, one.places, other.orientations, other.places
            )
            pairs = part.mean(axis=(0, 2))
            grid = (*one.grid, *other.grid)
            smooth = uniform_filter(pairs.reshape(grid), size=(1, 3, 3, 1, 3, 3), mode="nearest")
            pairs = (pairs + smooth.reshape(pairs.shape)) / 2
            distances = self._distances(one, other)
            half_octave: NDArray[np.int64] = (2 * np.log2(1 + distances)).astype(int)
            count = np.maximum(np.bincount(half_octave.ravel()), 1)
            typical = np.bincount(half_octave.ravel(), pairs.ravel()) / count
            each = one.orientations * other.orientations
            drawn = (each * pairs + typical[half_octave]) / (each + 1)
            self._spread(variance, one, other, drawn.astype(np.float32))
        floor: Float = np.maximum(variance, np.float32(1e-10) * variance.max())
        return floor

    def solve(self, observed: Float, iterations: int) -> None:
        """Find what is most probable given what is left of pictures (cells, P), 0 if unknown.

        That is C, `core`, and a diagonal for what cells send back directly, `direct`, by conjugate
        gradients in the space of the pictures.
        """
        self.direct = np.zeros(len(observed), np.float32)
        self._applied(
            conjugate_gradients(
                self._applied,
                observed,
                self._preconditioned,
                None,
                1e-3,
                iterations,
                preconditioned_norm=False,
            )
        )
        self.core = self._core
        if self.symmetric:
            self.core = self._core + self._core.T
            self.core[np.diag_indices(len(self.core))] /= 2

    def matrix(self) -> Float:
        """Return K of the last solution, (cells, cells)."""
        half = self.haar.inverse(self.core)
        matrix = self.lamp.inverse(np.ascontiguousarray(half.T))
        return matrix if self.symmetric else np.ascontiguousarray(matrix.T)

    def _applied(self, dual: Float) -> Float:
        """Apply the covariance of the pictures; the solution that goes with it is left behind."""
        sent = self.haar.forward(dual)
        if self.symmetric:
            pictures = self.haar.inverse(self._exchanged(sent))
            self.direct = self._direct * np.einsum("cm,cm->c", dual, self.cells)
            pictures += self.direct[:, None] * self.cells
        else:
            np.matmul(sent, self.light.T, out=self._core)
            self._core *= self.prior
            pictures = self.haar.inverse(self._core @ self.light)
        pictures += self._times * self._variance * dual
        pictures *= self._known
        return pictures

    def _exchanged(self, sent: Float) -> Float:
        """Return C times the light, C being the prior times ``sent light^T`` and its transpose.

        Of C one half is found, left of the diagonal, and the other one is never looked at.
        """
        from scipy.linalg.blas import ssymm, ssyr2k

        light, half = self.light.T, self._core.T  # in Fortran's order, as BLAS has it
        ssyr2k(1, sent.T, light, c=half, trans=1, overwrite_c=1)
        self._core *= self.prior
        exchanged: Float = ssymm(1, half, light, side=1).T
        return exchanged

    def _preconditioned(self, rest: Float) -> Float:
        coefficients = self.haar.forward(rest)
        for inverse, rows in zip(self._inverses, self._alike, strict=True):
            coefficients[rows] = coefficients[rows] @ inverse
        return self.haar.inverse(coefficients) * self._known
