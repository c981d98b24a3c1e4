"""The functions of both sides between which indirect light goes, and their pairs.

The camera's functions are B-splines of several scales, `MultiscaleBasis`, on its own side, or,
where the projector has several views, on a chart. On the projector's side the same functions arrive
as the footprints carry them, where the camera sees what the projector lights; where it doesn't,
there are B-splines of the projector's own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.chart import ChartBasis
from rfpipe.methods.footprints.sides import Carry
from rfpipe.methods.footprints.typed import Double, Float, Int32, Int64
from rfpipe.transport.multiscale.basis import REACH, VIEW, MultiscaleBasis

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["Functions"]

# A function of the projector's own is there where so much of it isn't seen.
_UNSEEN = 0.05
# Octaves of distance among which indirect light is shared a priori, as in near/far acquisition.
_OCTAVES = 12.0
# What goes one way and not the other, relative to what goes both ways.
_ODD = 0.2
# Unknowns are of one group in so many steps of scale and of distance; there are no more than these.
_STEPS_PER_OCTAVE, _SCALES = 4, 1024
_BINS_PER_SCALE, _BINS = 2, 256


@dataclass(frozen=True)
class Functions:
    """Functions over the rays of both sides.

    Attributes
    ----------
    camera : MultiscaleBasis
    own : MultiscaleBasis
        The projector's own.
    carry : Carry
    """

    camera: MultiscaleBasis
    own: MultiscaleBasis
    carry: Carry

    @property
    def count(self) -> int:
        """Number of unknowns: cores both ways, one way, and from functions of the projector."""
        return 2 * len(self.camera.first) + len(self.from_own[0])

    @cached_property
    def left(self) -> csr_array[np.float32]:
        """Functions over the camera's rays, (camera rays, n)."""
        return self.camera.weights

    @cached_property
    def right(self) -> csr_array[np.float32]:
        """Those functions and then the projector's own, (projector rays, n + own)."""
        from scipy.sparse import diags_array, hstack

        seen = self.carry.seen
        if isinstance(self.camera, ChartBasis):
            arriving = self.camera.at(np.asarray(self.carry.means @ self.camera.places))
        else:
            arriving = self.carry.means @ self.left
        carried = diags_array(seen) @ arriving
        together: Any = carried
        if len(self.own):
            together = hstack([carried, diags_array(1 - seen) @ self.own.weights])
        found: csr_array[np.float32] = together.tocsr().astype(np.float32)
        return found

    @cached_property
    def density(self) -> float:
        """Projector rays of a view that a camera ray spans a side, about."""
        if isinstance(self.camera, ChartBasis):
            return 1.0
        return float(np.sqrt(np.prod(self.own.shape) / np.prod(self.camera.shape)))

    @property
    def _crowd(self) -> float:
        """Projector rays of all views that light what a camera ray sees, about."""
        if isinstance(self.camera, ChartBasis):
            return float(RayDomain(self.own.shape).views)
        return self.density**2

    @cached_property
    def from_own(self) -> tuple[Int32, Int32, Double]:
        """Pairs of a camera's function and one of the projector's own, and their distances.

        Numbers of the functions, int32 (pairs,) each, and distances in camera pixels.
        """
        if not len(self.own):
            none = np.zeros(0, np.int32)
            return none, none, np.zeros(0)
        place, view, arrives = self._arrivals()
        apart = np.abs(place[:, None] - self.own.centres[None]) / self.density
        largest = apart.max(axis=2)
        scale, other = self.camera.scales[:, None], self.own.scales[None] / self.density
        coarser = np.maximum(scale, other)
        near = (largest <= REACH * coarser) & arrives[:, None]
        near &= view[:, None] == self.own.functions[None, :, VIEW]
        # the coarsest meet all; what doesn't arrive anywhere has no distance
        near |= (scale == self.camera.scales.max()) | (self.own.scales == self.own.scales.max())
        first, second = np.nonzero(near)
        side = max(RayDomain(self.camera.shape).image_shape)
        distance = np.hypot(*apart[first, second].T)
        distance = np.where(arrives[first], np.minimum(distance, side), side)
        return first.astype(np.int32), second.astype(np.int32), distance

    def _arrivals(self) -> tuple[Double, Int64, NDArray[np.bool_]]:
        """Return where the camera's functions are on the projector, and which are at all."""
        carried = self.right[:, : len(self.camera)]
        views, height, width = RayDomain(self.own.shape).stack_shape
        ray = np.arange(views * height * width)
        place = np.column_stack(
            [ray // width % height + 0.5, ray % width + 0.5, ray // (width * height)]
        )
        mass = np.asarray(carried.sum(axis=0), np.float64).ravel()
        arrives = mass > 1e-6 * mass.max(initial=0)
        found = (carried.T @ place) / np.where(arrives, mass, 1)[:, None]
        return found[:, :2], np.rint(found[:, 2]).astype(np.int64), arrives

    def deviations(self, indirect: float, floodlit: float) -> Float:
        """Return how large cores are expected to be before any fit, (count,).

        Parameters
        ----------
        indirect : float
            Indirect light under full light, radiance.
        floodlit : float
            Mean floodlit radiance.
        """
        _, _, coarser, distance, odd = self._places()
        area = np.square(np.maximum(distance, coarser)) * _OCTAVES
        level = indirect / (max(floodlit, float(np.finfo(np.float32).tiny)) ** 2)
        expected = level / (area * self._crowd)
        return np.where(odd, _ODD * expected, expected).astype(np.float32)

    @cached_property
    def groups(self) -> Int64:
        """Number of each unknown's group: those of the same scales at about the same distance."""
        kind, finer, coarser, distance, _ = self._places()
        key = kind.astype(np.int64)
        for scale in (coarser, finer):
            # scales of the other side may lie below one camera pixel
            key = key * _SCALES + np.rint(_STEPS_PER_OCTAVE * np.log2(scale)).astype(np.int64)
        place = np.minimum(_BINS_PER_SCALE * distance / coarser, _BINS - 1).astype(np.int64)
        found: Int64 = np.unique(key * _BINS + place, return_inverse=True)[1]
        return found

    def _places(self) -> tuple[Int64, Double, Double, Double, NDArray[np.bool_]]:
        """Return kind, finer and coarser scale, and distance of all unknowns; which are odd."""
        basis = self.camera
        scales = basis.scales[basis.first], basis.scales[basis.second]
        first, second, apart = self.from_own
        others = basis.scales[first], self.own.scales[second] / self.density
        finer = np.concatenate([np.minimum(*scales)] * 2 + [np.minimum(*others)])
        coarser = np.concatenate([np.maximum(*scales)] * 2 + [np.maximum(*others)])
        near = basis.distances()
        distance = np.concatenate([near, near, apart])
        kind = np.repeat([0, 1, 2], [len(near), len(near), len(apart)])
        return kind, finer.astype(np.float64), coarser.astype(np.float64), distance, kind == 1

    def cores(self, unknowns: Any) -> csr_array[np.float32]:
        """Return what the functions exchange as a sparse matrix (n, n + own)."""
        from scipy.sparse import coo_array

        basis, pairs = self.camera, len(self.camera.first)
        even, odd, own = unknowns[:pairs], unknowns[pairs : 2 * pairs], unknowns[2 * pairs :]
        first, second, _ = self.from_own
        off = basis.first != basis.second
        rows = np.concatenate([basis.first, basis.second[off], first])
        columns = np.concatenate([basis.second, basis.first[off], second + len(basis)])
        values = np.concatenate([even + odd, (even - odd)[off], own]).astype(np.float32)
        shape = (len(basis), len(basis) + len(self.own))
        return coo_array((values, (rows, columns)), shape=shape).tocsr()
