"""Residual pictures of one channel in cells, the data of `rfpipe.methods.residual.posterior`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Float, Numbers
from rfpipe.transport.wavelet import Group, Haar

# Share of the variance of residual pictures that light returned to its own cell may explain.
_DIRECT_SHARE = 0.02


class WaveletPairs(NamedTuple):
    """Pairs of wavelets with a prior variance, in the order of their first wavelets."""

    first: Numbers  # a, (pairs,)
    second: Numbers  # b, (pairs,)
    variance: Float  # V, (pairs,)


@dataclass(frozen=True)
class CellData:
    """Residual pictures of one channel, in cells.

    Attributes
    ----------
    haar, sender_haar : Haar
        Of the camera's and of the projector's cells.
    places : ndarray of float32, shape (N', 2), optional
        Row and column, in the camera's cells, of the spot that each projector cell lights. None for
        coaxial rigs, whose K is symmetric.
    cell_light : ndarray of float32, shape (N', P)
    light : ndarray of float32, shape (n, P)
    known : ndarray of bool, shape (M', P)
        Cells with a known pixel.
    observed, variance : ndarray of float32, shape (M', P)
        0 where a cell is unknown.
    """

    haar: Haar
    sender_haar: Haar
    places: Float | None
    cell_light: Float
    light: Float
    known: NDArray[np.bool_]
    observed: Float
    variance: Float

    @property
    def is_symmetric(self) -> bool:
        """True on a coaxial rig."""
        return self.places is None

    @cached_property
    def noise(self) -> float:
        """Harmonic mean of the variances of the noise."""
        certainty = np.divide(1, self.variance, where=self.known, out=np.zeros_like(self.observed))
        return 1 / max(float(certainty.mean(dtype=np.float64)), TINY)

    @cached_property
    def direct_variance(self) -> np.float32:
        """V_d, the prior variance of the light that a cell returns to itself."""
        power = max(float(np.square(self.cell_light, dtype=np.float64).mean()), TINY)
        return np.float32(_DIRECT_SHARE * self.observed.var(dtype=np.float64) / power)

    @cached_property
    def place_groups(self) -> list[NDArray[np.int64]]:
        """Numbers of the camera's wavelets of each place, (places, wavelets), scale by scale."""
        return [np.stack(group.by_place()) for group in self.haar.groups]

    def matrix(self, first: Numbers, second: Numbers, cores: Float) -> Float:
        """Compute K, (M', N'), from the entries of X of some pairs of wavelets, (pairs,) each."""
        X = np.zeros((self.haar.size, self.sender_haar.size), np.float32)
        X[first, second] = cores
        if self.is_symmetric:
            X[second, first] = cores
        return self.haar.inverse_both(X, self.sender_haar)

    def residual(self, matrix: Float, direct: Float) -> Float:
        """Subtract the pictures predicted by K and d from y; 0 where a cell is unknown."""
        predicted = matrix @ self.cell_light
        if self.is_symmetric:
            predicted += direct[:, None] * self.cell_light
        residual: Float = np.where(self.known, self.observed - predicted, 0)
        return residual

    def direct(self, matrix: Float) -> Float:
        """Compute the most probable d for a K, (M',); 0 on rigs that aren't coaxial."""
        if not self.is_symmetric:
            return np.zeros(len(matrix), np.float32)
        certainty = np.divide(1, self.variance, where=self.known, out=np.zeros_like(self.observed))
        weighted, no_direct = certainty * self.cell_light, np.zeros(len(matrix), np.float32)
        power = np.einsum("cp,cp->c", weighted, self.cell_light) + 1 / self.direct_variance
        residual = self.residual(matrix, no_direct)
        direct: Float = np.einsum("cp,cp->c", weighted, residual) / power
        return direct

    def scale_pairs(self) -> Iterator[tuple[Group, Group]]:
        """Yield each pair of scales of the camera and the projector; once where K is symmetric."""
        for index, group in enumerate(self.haar.groups):
            for sender_group in self.sender_haar.groups[index if self.is_symmetric else 0 :]:
                yield group, sender_group

    def distances(self, group: Group, sender_group: Group) -> Float:
        """Compute the distances of the places of two scales in cells, across views too."""
        centres = sender_group.centres()
        if self.places is not None:
            _, height, width = self.sender_haar.stack
            cell = np.minimum(centres.astype(np.int64), (height - 1, width - 1))
            views, rows, columns = sender_group.grid
            view = np.repeat(np.arange(views), rows * columns)
            centres = self.places[(view * height + cell[:, 0]) * width + cell[:, 1]]
        offset = group.centres()[:, None] - centres
        distance: Float = np.hypot(offset[..., 0], offset[..., 1])
        return distance


def cell_data(
    haar: Haar,
    cell_light: Float,
    observed: Float,
    variance: Float,
    sender: tuple[Haar, Float] | None = None,
) -> CellData:
    """Prepare residual pictures.

    Parameters
    ----------
    haar : Haar
        Of the camera's cells.
    cell_light : ndarray of float32, shape (N', P)
        Sums over the projector's cells of the patterns times the projector's factor.
    observed, variance : ndarray of float32, shape (M', P)
        The variance is infinite where a cell has no known pixel.
    sender : tuple of Haar and ndarray, optional
        Of the projector's cells, and their places, see `CellData`. None for coaxial rigs.
    """
    known = np.isfinite(variance)
    sender_haar, places = (haar, None) if sender is None else sender
    cell_light = np.ascontiguousarray(cell_light)
    return CellData(
        haar,
        sender_haar,
        places,
        cell_light,
        sender_haar.forward(cell_light),
        known,
        np.where(known, observed, 0),
        np.where(known, variance, 0),
    )
