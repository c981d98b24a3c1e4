"""Candidate footprints: the sparse matrix D of direct light, stored by projector view.

============  ================  ======  ============================================================
symbol        name in the code  shape   meaning and unit
============  ================  ======  ============================================================
``D``         `matrix`          (M, N)  radiance of camera pixel i when projector pixel j alone is
                                        on; sparse
``i N + j``   `keys`            (K,)    places of the K candidate entries of D
``D_ij``      `weights`         (K,)    their values, radiance
variance      `variance`        (K,)    their prior variances, radiance squared
============  ================  ======  ============================================================
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float, Index
from rfpipe.store.scratch import ScratchArray
from rfpipe.transport.hierarchical.leaves import ragged_ranges

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Candidates:
    """Projector pixels that may light each camera pixel directly, with their weights.

    Attributes
    ----------
    camera_size, projector_size : int
        M and N: the number of camera pixels, and of projector pixels of one view.
    keys : ndarray of int64, shape (K,)
        ``i N + j`` if projector pixel j is a candidate of camera pixel i; distinct, ascending.
    variance : ndarray of float32, shape (K,)
        Prior variance of each weight, radiance squared.
    weights : ndarray of float32, shape (K,)
        Radiance of i when j alone is on, at least 0.
    """

    camera_size: int
    projector_size: int
    keys: Index
    variance: Float
    weights: Float

    @property
    def camera_pixels(self) -> Index:
        """Number i of each candidate's camera pixel, (K,)."""
        return self.keys // self.projector_size

    @property
    def projector_pixels(self) -> NDArray[np.int32]:
        """Number j of each candidate's projector pixel, (K,)."""
        return (self.keys % self.projector_size).astype(np.int32)

    @property
    def starts(self) -> Index:
        """Index of each camera pixel's first candidate, and K at the end, (M + 1,)."""
        return np.searchsorted(self.keys, np.arange(self.camera_size + 1) * self.projector_size)

    def matrix(self, values: NDArray[Any] | None = None) -> csr_array[Any]:
        """Return the weights, or other values (K,), as a sparse matrix (M, N)."""
        from scipy.sparse import csr_array

        values = self.weights if values is None else values
        starts = self.starts.astype(np.int32)
        shape = (self.camera_size, self.projector_size)
        return csr_array((values, self.projector_pixels, starts), shape=shape)

    def with_variance(
        self, floodlit: Float, weight_fraction: float, floodlit_fraction: float
    ) -> Candidates:
        """Set the prior variance to ``(weight_fraction D)^2 + (floodlit_fraction F)^2``.

        `floodlit` is F, (M,).
        """
        variance = np.square(weight_fraction * self.weights)
        variance += np.square(floodlit_fraction * floodlit[self.camera_pixels])
        return replace(self, variance=variance.astype(np.float32))

    def scaled(self, share: Float) -> Candidates:
        """Multiply the weights by a factor of each camera pixel, (M,), variances by its square."""
        factor = share[self.camera_pixels]
        variance, weights = self.variance * np.square(factor), self.weights * factor
        return replace(self, variance=variance, weights=weights)

    def above(self, fraction: float, floodlit: Float, exempt: Index | None = None) -> Candidates:
        """Select weights above a fraction of the floodlit image (M,), and all of `exempt` pixels.

        `exempt` are numbers of camera pixels.
        """
        pixels = self.camera_pixels
        mask = self.weights > fraction * floodlit[pixels]
        if exempt is not None:
            is_exempt = np.zeros(self.camera_size, np.bool_)
            is_exempt[exempt] = True
            mask |= is_exempt[pixels]
        return self._masked(mask)

    def at(self, camera_pixels: Index | None) -> Candidates:
        """Select camera pixels by their numbers, ascending; None selects all."""
        if camera_pixels is None:
            return self
        starts, size = self.starts, self.projector_size
        counts = np.diff(starts)[camera_pixels]
        index = ragged_ranges(starts[camera_pixels], counts)
        keys = np.repeat(np.arange(len(camera_pixels)), counts) * size + self.keys[index] % size
        variance, weights = self.variance[index], self.weights[index]
        return Candidates(len(camera_pixels), size, keys, variance, weights)

    def between(self, first: int, last: int) -> Candidates:
        """Select the camera pixels ``first:last``; arrays are views, except `keys`."""
        begin, end = np.searchsorted(
            self.keys, [first * self.projector_size, last * self.projector_size]
        )
        keys = self.keys[begin:end] - first * self.projector_size
        return Candidates(
            last - first,
            self.projector_size,
            keys,
            self.variance[begin:end],
            self.weights[begin:end],
        )

    def with_pixels(self, camera_pixels: Index, part: Candidates) -> Candidates:
        """Replace the candidates of camera pixels (m,), ascending, by those of `part`."""
        if not len(camera_pixels):
            return self
        is_replaced = np.zeros(self.camera_size, np.bool_)
        is_replaced[camera_pixels] = True
        other = self._masked(~is_replaced[self.camera_pixels])
        size = self.projector_size
        keys = camera_pixels[part.camera_pixels] * size + part.keys % size
        keys = np.concatenate([other.keys, keys])
        order = np.argsort(keys, kind="stable")  # merges two sorted runs
        variance = np.concatenate([other.variance, part.variance])[order]
        weights = np.concatenate([other.weights, part.weights])[order]
        return replace(self, keys=keys[order], variance=variance, weights=weights)

    def _masked(self, mask: Bools) -> Candidates:
        return replace(
            self, keys=self.keys[mask], variance=self.variance[mask], weights=self.weights[mask]
        )


def unique_keys(keys: Index) -> Index:
    """Return the distinct keys, ascending; faster than `numpy.unique` on sorted runs."""
    ordered = np.sort(keys, kind="stable")  # merges the runs
    is_first = np.ones(len(ordered), np.bool_)
    np.not_equal(ordered[1:], ordered[:-1], out=is_first[1:])
    return ordered[is_first]


def join_pixels(parts: Sequence[Candidates]) -> Candidates:
    """Join the candidates of consecutive ranges of camera pixels, the inverse of `between`."""
    if len(parts) == 1:
        return parts[0]
    size, ends = parts[0].projector_size, np.cumsum([part.camera_size for part in parts])
    starts = ends - [part.camera_size for part in parts]
    keys = [part.keys + start * size for part, start in zip(parts, starts, strict=True)]
    variance, weights = (
        np.concatenate(arrays)
        for arrays in zip(*((part.variance, part.weights) for part in parts), strict=True)
    )
    return Candidates(int(ends[-1]), size, np.concatenate(keys), variance, weights)


@dataclass(frozen=True)
class StoredCandidates:
    """Candidates on each projector view, in temporary files of which parts are read.

    A light field may have hundreds of millions of candidates. They are ordered by view, then by
    camera pixel, then by projector pixel.

    Attributes
    ----------
    camera_size, projector_size : int
        M, and N of one view.
    starts : ScratchArray of int64, shape (views (M + 1),)
        For each view, the index of each camera pixel's first candidate, and one past the last.
    projector_pixels : ScratchArray of int32, shape (K,)
        Number of each candidate's projector pixel in its view.
    variance, weights : ScratchArray of float32, shape (K,)
        As in `Candidates`.
    """

    camera_size: int
    projector_size: int
    starts: ScratchArray
    projector_pixels: ScratchArray
    variance: ScratchArray
    weights: ScratchArray

    @classmethod
    def of(cls, views: Iterable[Candidates]) -> Self:
        """Store candidates on each view; one view at a time is in memory."""
        starts, pixels = ScratchArray(np.int64), ScratchArray(np.int32)
        variance, weights = ScratchArray(np.float32), ScratchArray(np.float32)
        for part in views:
            starts.append(part.starts + len(pixels))
            pixels.append(part.projector_pixels)
            variance.append(part.variance)
            weights.append(part.weights)
        return cls(part.camera_size, part.projector_size, starts, pixels, variance, weights)

    def __len__(self) -> int:
        """Return the number of projector views."""
        return len(self.starts) // (self.camera_size + 1)

    def __iter__(self) -> Iterator[Candidates]:
        return (self[view] for view in range(len(self)))

    def __getitem__(self, view: int) -> Candidates:
        """Read the candidates on a view."""
        return self.between(view, 0, self.camera_size)

    def between(self, view: int, first: int, last: int) -> Candidates:
        """Read the candidates of the camera pixels ``first:last`` on a view."""
        before = view * (self.camera_size + 1)
        starts, size = self.starts[before + first : before + last + 1], self.projector_size
        part = slice(starts[0], starts[-1])
        keys = np.repeat(np.arange(last - first) * size, np.diff(starts))
        keys += self.projector_pixels[part]
        return Candidates(last - first, size, keys, self.variance[part], self.weights[part])
