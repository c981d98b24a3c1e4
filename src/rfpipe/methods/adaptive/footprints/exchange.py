"""What functions exchange, and each pixel's gain: regularised least squares over all pictures.

Footprints' weights are marginalised (`Precision`), so that every pixel serves the fit, lit or not,
and what is found of indirect light does not depend on how well direct light is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.methods.adaptive.footprints.candidates import Precision
from rfpipe.methods.adaptive.footprints.functions import Functions
from rfpipe.methods.adaptive.footprints.series import Float, Int64, Series
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.methods.smooth_light import learned_deviations
from rfpipe.steps import step

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ROUGHLY, NEARLY, FULLY = (1e-2, 40), (1e-3, 120), (3e-4, 200)
"""Part of the residual at which to stop, and iterations at most."""

# The least and the largest gain.
_LEAST, _MOST = 0.2, 4.0


@dataclass(frozen=True)
class Exchange:
    """Indirect light ``f L S R^T g`` of one channel, and what pictures say of it.

    Attributes
    ----------
    functions : Functions
    precision : tuple of Precision
        Of each series.
    series : tuple of Series
        Pictures of the camera rays that the fit looks at, one series for each view of the
        projector.
    factors : tuple of two ndarrays of float32, shape (camera rays,), (projector rays,)
        f and g as the footprints and the floodlit image have them.
    gains : tuple of two ndarrays of float32
        What the pictures make of these, pixel by pixel: 1 where nothing is known.
    unknowns : ndarray of float32, shape (functions.count,)
        S: cores both ways, and one way.
    looked_at : ndarray of int64, optional
        The camera rays that the fit looks at; None for all.
    """

    functions: Functions
    precision: tuple[Precision, ...]
    series: tuple[Series, ...]
    factors: tuple[Float, Float]
    gains: tuple[Float, Float]
    unknowns: Float
    looked_at: Int64 | None = None

    @property
    def camera(self) -> Float:
        """f, (camera rays,)."""
        return self.factors[0] * self.gains[0]

    @property
    def projector(self) -> Float:
        """g, (projector rays,)."""
        return self.factors[1] * self.gains[1]

    @property
    def shares_rays(self) -> bool:
        """Whether camera and projector share their rays, as footprints have shown."""
        return self.functions.carry.shared

    def indirect(self) -> list[Float]:
        """Return the indirect light of each series' patterns on all camera rays, (rays, M)."""
        everywhere = replace(self, looked_at=None)
        light = everywhere._forward(self.unknowns, self._light(self.projector))
        return self._parts(light)

    def fitted(self, deviations: Float, accuracy: tuple[float, int]) -> Exchange:
        """Find S by conjugate gradients from where it is; `deviations` are those of unknowns."""
        light = self._light(self.projector)

        def back(observed: Float) -> Float:
            return deviations * self._adjoint(self._applied(observed), light)

        def normal(known: Float) -> Float:
            return back(self._forward(deviations * known, light)) + known

        start = np.zeros_like(deviations)
        np.divide(self.unknowns, deviations, out=start, where=deviations > 0)
        scaling = np.float32(1) / (1 + self._diagonal(light) * np.square(deviations))
        goal = back(self._observed)
        solution = conjugate_gradients(normal, goal, scaling.__mul__, start, *accuracy)
        step()
        return replace(self, unknowns=deviations * solution)

    def beyond(self, allowed: float) -> tuple[Float, Float, Float]:
        """Return what each looked-at pixel's pictures are wrong by, and what they may be.

        Three arrays (rays,): squared standard deviations; how many noise alone would make; how
        many an error of `allowed` of the floodlit image makes.
        """
        predicted = self._parts(self._forward(self.unknowns, self._light(self.projector)))
        sums = []
        for series, precision, light in zip(self.series, self.precision, predicted, strict=True):
            wrong = series.observed - light
            count = series.lit.shape[1]
            known = np.minimum(np.diff(precision.starts), count // 2)
            free = np.where(series.known, count - known, 0)
            excess = np.einsum("im,im->i", wrong, precision.applied(wrong))
            sums.append((excess, free, precision.trace * np.square(allowed * series.floodlit)))
        excess, free, limit = (sum(each[1:], each[0]) for each in zip(*sums, strict=True))
        return excess, free, limit

    def learned(self) -> Float:
        """Return deviations by group, as the root of the mean square of what was found."""
        return learned_deviations(self.functions.groups, self.unknowns)

    def with_gains(self) -> Exchange:
        """Fit the gain of each projector pixel, then of each camera pixel, given S.

        Of a fit that doesn't look at all camera rays they stay what they are.
        """
        if self.looked_at is not None:
            return self
        return self._with_projector_gains()._with_camera_gains()

    def _with_projector_gains(self) -> Exchange:
        functions = self.functions
        spread = np.where(functions.carry.seen > 1 / 2, 0.05, 0.3).astype(np.float32)
        cores = functions.cores(self.unknowns)
        factor, camera = self.factors[1], self.camera

        def forward(gain: Float) -> Float:
            sent = self._light(gain * factor)
            light: Float = (functions.left @ (cores @ sent)) * camera[:, None]
            return light

        def back(observed: Float) -> Float:
            received = functions.left.T @ (self._applied(observed) * camera[:, None])
            light = zip(self._rights, self._parts(cores.T @ received), self.series, strict=True)
            change = [np.einsum("jm,jm->j", each.lit, right @ part) for right, part, each in light]
            gradient: Float = spread * factor * np.concatenate(change)
            return gradient

        def normal(change: Float) -> Float:
            return back(forward(spread * change)) + change

        goal = back(self._observed - forward(np.ones_like(spread)))
        start = ((self.gains[1] - 1) / spread).astype(np.float32)
        change = conjugate_gradients(normal, goal, np.copy, start, 1e-2, 25)
        gain = np.clip(1 + spread * change, _LEAST, _MOST)
        return replace(self, gains=(self.gains[0], gain))

    def _with_camera_gains(self) -> Exchange:
        predicted = np.concatenate(self.indirect(), axis=1) / self.gains[0][:, None]
        weighed, stiff = self._applied(predicted), np.float32(1 / 0.1**2)
        least = np.einsum("im,im->i", weighed, predicted) + stiff
        gain = (np.einsum("im,im->i", weighed, self._observed) + stiff) / least
        return replace(self, gains=(np.clip(gain, _LEAST, _MOST), self.gains[1]))

    @cached_property
    def _observed(self) -> Float:
        """All pictures of the rays that the fit looks at, (rays, all M)."""
        return np.concatenate([each.observed for each in self.series], axis=1)

    @cached_property
    def _left(self) -> csr_array[np.float32]:
        """The functions over the rays that the fit looks at."""
        left = self.functions.left
        rows: csr_array[np.float32] = left if self.looked_at is None else left[self.looked_at]
        return rows

    @cached_property
    def _rights(self) -> list[csr_array[np.float32]]:
        """The functions over the projector's rays, view by view."""
        right, rays = self.functions.right, len(self.series[0].lit)
        if len(self.series) == 1:
            return [right]
        return [right[view * rays : (view + 1) * rays] for view in range(len(self.series))]

    def _looked(self, values: Float) -> Float:
        return values if self.looked_at is None else values[self.looked_at]

    def _parts(self, joined: Float) -> list[Float]:
        """Return each series' part of what is joined by pictures, (..., all M)."""
        ends = np.cumsum([each.observed.shape[1] for each in self.series])
        return np.split(joined, ends[:-1], axis=1)

    def _applied(self, observed: Float) -> Float:
        """Return all pixels' precision times pictures (rays, all M)."""
        parts = zip(self.precision, self._parts(observed), strict=True)
        return np.concatenate([each.applied(part) for each, part in parts], axis=1)

    def _light(self, projector: Float) -> Float:
        """Return what patterns send to the functions, (n, all M)."""
        rays = len(self.series[0].lit)
        factors = projector.reshape(len(self.series), rays, 1)
        sides = zip(self._rights, self.series, factors, strict=True)
        light = [right.T @ (each.lit * factor) for right, each, factor in sides]
        return np.ascontiguousarray(np.concatenate(light, axis=1), np.float32)

    def _forward(self, unknowns: Float, light: Float) -> Float:
        from rfpipe.methods.adaptive.footprints.kernels import couple

        basis = self.functions.camera
        received = np.zeros((len(basis), light.shape[1]), np.float32)
        even, odd = np.split(unknowns, 2)
        couple(basis.first, basis.second, even, odd, light, received)
        predicted: Float = (self._left @ received) * self._looked(self.camera)[:, None]
        return predicted

    def _adjoint(self, observed: Float, light: Float) -> Float:
        from rfpipe.methods.adaptive.footprints.kernels import correlate

        basis = self.functions.camera
        arriving = self._left.T @ (observed * self._looked(self.camera)[:, None])
        arriving = np.ascontiguousarray(arriving, np.float32)
        out = np.empty(self.functions.count, np.float32)
        even, odd = np.split(out, 2)
        correlate(basis.first, basis.second, arriving, light, even, odd)
        return out

    def _diagonal(self, light: Float) -> Float:
        """Estimate the diagonal of the normal equations' matrix."""
        basis, left = self.functions.camera, self._left
        trace = sum(each.trace for each in self.precision)
        certainty = trace / light.shape[1] * np.square(self._looked(self.camera))
        weight = left.multiply(left).T @ certainty
        power = np.einsum("am,am->a", light, light)
        one = weight[basis.first] * power[basis.second]
        other = weight[basis.second] * power[basis.first]
        both = np.where(basis.first == basis.second, one, one + other)
        return np.concatenate([both, both]).astype(np.float32)
