"""The most probable K of one channel, by conjugate gradients in the space of the pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.methods.residual.prior import first_guess, learned
from rfpipe.transport.wavelet.haar import Haar

__all__ = ["Evidence", "Posterior"]

# Variance of what cells send back directly, of that of what the model leaves of the pictures.
_DIRECT = 0.02
# The pictures don't make a variance smaller than this part of it.
_LEAST_LEFT = 1e-4
# Part of the residual at which to stop.
_STOP = 1e-3
_ROUNDING = float(np.finfo(np.float32).eps)
_TINY = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Evidence:
    """What a model leaves of pictures of cells, over F.

    Attributes
    ----------
    light : ndarray of float32, shape (cells, M)
        Sums of the patterns times F.
    seen, variance : ndarray of float32, shape (cells, M)
        The variance is infinite where nothing is known.
    """

    light: Float
    seen: Float
    variance: Float


class Posterior:
    """K given pictures.

    Parameters
    ----------
    haar : Haar
    evidence : Evidence
    """

    def __init__(self, haar: Haar, evidence: Evidence) -> None:
        self.haar, self.cells = haar, np.ascontiguousarray(evidence.light)
        self._known = np.isfinite(evidence.variance)
        self.seen = np.where(self._known, evidence.seen, 0)
        self._variance = np.where(self._known, evidence.variance, 0)
        certainty = np.divide(1, self._variance, where=self._known, out=np.zeros_like(self.seen))
        self._noise = 1 / max(float(certainty.mean(dtype=np.float64)), _TINY)
        self.light = haar.forward(self.cells)
        lit = max(float(np.square(self.cells, dtype=np.float64).mean()), _TINY)
        self._direct = np.float32(_DIRECT * self.seen.var(dtype=np.float64) / lit)
        self._alike = [rows for group in haar.groups for rows in group.alike()]

    def left(self, told: Float) -> Float:
        """Return what pictures (cells, M) leave of those that were taken; 0 if unknown."""
        left: Float = np.where(self._known, self.seen - told, 0)
        return left

    def guessed(self) -> Float:
        """Return variances of C before any fit, (size, size)."""
        changing = self.light - self.light.mean(axis=1, keepdims=True)
        unit = np.square(changing, dtype=np.float64).sum(axis=0).mean() / len(changing)
        energy = np.square(self.seen, dtype=np.float64).sum(axis=0).mean()
        return first_guess(self.haar, float(energy / max(unit, _TINY)))

    def prepare(self, prior: Float, times: int = 1) -> None:
        """Take a prior (size, size), and pictures whose variances are some times larger."""
        self.prior, self._times = prior, np.float32(times)
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
        """Return the variances of C that its last solution, and what is unsure of it, suggest."""
        from rfpipe.methods.residual.kernels import expected_squares

        told = np.empty_like(self.prior)
        for root, rows in zip(self._roots, self._alike, strict=True):
            told[rows] = np.square(root @ self.light.T).sum(axis=0)
        expected_squares(self.core, self.prior, told, np.float32(_LEAST_LEFT))
        return learned(self.haar, told)

    def solve(self, seen: Float, iterations: int) -> None:
        """Find what is most probable given what is left of pictures (cells, M), 0 if unknown.

        That is C, `core`, and a diagonal for what cells send back directly, `direct`.
        """
        dual, rest = np.zeros_like(seen), seen
        step = direction = self._preconditioned(rest)
        energy, goal = _dot(rest, step), _STOP**2 * _dot(seen, seen)
        for _ in range(iterations):
            if energy <= 0 or _dot(rest, rest) <= goal:
                break
            image = self._applied(direction)
            curvature = _dot(direction, image)
            if curvature <= 0:  # rounding is all that is left
                break
            length = np.float32(energy / curvature)
            dual, rest = dual + length * direction, rest - length * image
            step = self._preconditioned(rest)
            before, energy = energy, _dot(rest, step)
            direction = step + np.float32(energy / before) * direction
        self._applied(dual)

    def matrix(self) -> Float:
        """Return K of the last solution, (cells, cells)."""
        half = self.haar.inverse(self.core)
        return self.haar.inverse(np.ascontiguousarray(half.T))

    def _applied(self, dual: Float) -> Float:
        """Apply the covariance of the pictures; the solution that goes with it is left behind."""
        from rfpipe.methods.residual.kernels import symmetric_product

        core: Float = self.haar.forward(dual) @ self.light.T
        symmetric_product(core, self.prior)
        self.core = core
        self.direct = self._direct * np.einsum("cm,cm->c", dual, self.cells)
        seen = self.haar.inverse(core @ self.light)
        seen += self.direct[:, None] * self.cells
        seen += self._times * self._variance * dual
        seen *= self._known
        return seen

    def _preconditioned(self, rest: Float) -> Float:
        found = self.haar.forward(rest)
        for inverse, rows in zip(self._inverses, self._alike, strict=True):
            found[rows] = found[rows] @ inverse
        return self.haar.inverse(found) * self._known


def _dot(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    return float(np.einsum("cm,cm->", a, b, dtype=np.float64))
