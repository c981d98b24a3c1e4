"""The functions of both sides between which indirect light goes, and their pairs.

The camera's functions are B-splines of several scales, `MultiscaleBasis`, on its own side, or,
where the projector has several views, on a chart. On the projector's side the same functions arrive
as the footprints carry them, where the camera sees what the projector lights.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.series import Double, Float, Int32, Int64
from rfpipe.methods.images import nearest
from rfpipe.methods.smooth_light import prior_areas
from rfpipe.transport.multiscale import (
    MultiscaleBasis,
    along,
    numbers,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Carry:
    """How functions over the camera's pixels become functions over the projector's.

    A projector pixel takes the mean of the camera pixels that see what it lights.

    Attributes
    ----------
    means : csr_array of float32, shape (projector pixels, camera pixels)
        Rows of sum 1, or 0 where nothing is seen.
    seen : ndarray of float32, shape (projector pixels,)
        How well the camera sees what a projector pixel lights, 0 to 1.
    shared : bool
        Whether each projector pixel is the camera pixel of the same number.
    """

    means: csr_array[np.float32]
    seen: Float
    shared: bool = False


def carry_of(direct: csr_array[np.float32], floodlit: Float) -> Carry:
    """Take the way from camera to projector out of footprints (camera pixels, projector pixels).

    A projector pixel is half seen where .15 of its light comes back, relative to what the camera
    sees.
    """
    from scipy.sparse import diags_array

    sent: Float = np.asarray(direct.sum(axis=0)).ravel()
    share = np.divide(1, sent, out=np.zeros_like(sent), where=sent > 0)
    means = (diags_array(share) @ direct.T).tocsr().astype(np.float32)
    typical = means @ floodlit
    share = np.divide(sent, typical, out=np.zeros_like(sent), where=typical > 0)
    # where a camera pixel covers several projector pixels each gets a part of its light
    usual = float(np.median(share[share > 0])) if (share > 0).any() else 1.0
    share = share / usual
    visibility = np.where(share > 0.05, share / (share + 0.15), 0)
    return Carry(means, visibility.astype(np.float32))


def shared_rays(size: int) -> Carry:
    """Return the way between the sides of a coaxial rig of so many rays."""
    from scipy.sparse import eye_array

    return Carry(eye_array(size, dtype=np.float32).tocsr(), np.ones(size, np.float32), True)


def camera_factor(direct: csr_array[np.float32], floodlit: Float) -> Float:
    """Return how much indirect light each camera pixel takes, in units of the floodlit image.

    It is what the floodlit image has besides direct light, so that it has no jump at the edge of a
    shadow, scaled to be as bright as the floodlit image where a pixel is lit.
    """
    lit: Float = np.asarray(direct.sum(axis=1)).ravel()
    rest = np.maximum(floodlit - lit, 1e-6 * floodlit)
    mask = (lit > 0.5 * floodlit) & (rest > 0)
    ratio = np.clip(np.median(floodlit[mask] / rest[mask]), 1, 20.0) if mask.any() else 1.0
    factor: Float = (np.clip(rest, 0.03 * floodlit, floodlit) * ratio).astype(np.float32)
    return factor


def projector_factor(carry: Carry, factor: Float, floodlit: Float) -> Float:
    """Return how much indirect light each projector pixel gives, in the same units.

    Where the camera doesn't see it, it is as much as of a typical pixel.
    """
    shining = floodlit[floodlit > 0]
    typical = float(np.median(shining)) if len(shining) else 0.0
    light: Float = carry.seen * (carry.means @ factor) + (1 - carry.seen) * np.float32(typical)
    return light.astype(np.float32)


@dataclass(frozen=True)
class Functions:
    """Functions over the camera's rays, and as they arrive on the projector's side.

    Where the camera doesn't see what the projector lights there are none: what rays send from there
    is left to the residual.
    """

    camera: MultiscaleBasis
    projector: RayDomain
    carry: Carry

    @property
    def count(self) -> int:
        """Number of unknowns: cores both ways, and one way."""
        return 2 * len(self.camera.first)

    @cached_property
    def left(self) -> csr_array[np.float32]:
        """The functions over the camera's rays, (camera rays, n)."""
        return self.camera.weights

    @cached_property
    def right(self) -> csr_array[np.float32]:
        """The functions over the projector's rays, (projector rays, n)."""
        from scipy.sparse import diags_array

        if isinstance(self.camera, ChartBasis):
            arriving = self.camera.at(np.asarray(self.carry.means @ self.camera.places))
        else:
            arriving = self.carry.means @ self.left
        carried: Any = diags_array(self.carry.seen) @ arriving
        matrix: csr_array[np.float32] = carried.tocsr().astype(np.float32)
        return matrix

    @property
    def _crowd(self) -> float:
        """Projector rays of all views that light what a camera ray sees, about."""
        if isinstance(self.camera, ChartBasis):
            return float(self.projector.views)
        return float(self.projector.size / np.prod(self.camera.shape))

    def deviations(self, indirect: float, floodlit: float) -> Float:
        """Return how large cores are expected to be before any fit, (count,).

        `indirect` is the indirect light under full light, `floodlit` the mean floodlit radiance.
        What goes one way and not the other is a fifth of what goes both ways.
        """
        basis = self.camera
        area = prior_areas(basis)
        level = indirect / (max(floodlit, float(np.finfo(np.float32).tiny)) ** 2)
        expected = level / (area * self._crowd)
        return np.concatenate([expected, 0.2 * expected]).astype(np.float32)

    @cached_property
    def groups(self) -> Int64:
        """Number of each unknown's group: those of the same scales at about the same distance."""
        basis = self.camera
        scales = basis.scales[basis.first], basis.scales[basis.second]
        key = np.zeros(len(basis.first), np.int64)
        for scale in (np.maximum(*scales), np.minimum(*scales)):
            # in quarters of an octave
            key = key * 1024 + np.rint(4 * np.log2(scale)).astype(np.int64)
        place = np.minimum(2 * basis.distances() / np.maximum(*scales), 255).astype(np.int64)
        key = key * 256 + place
        group: Int64 = np.unique(np.concatenate([key, key + (1 << 40)]), return_inverse=True)[1]
        return group

    def cores(self, unknowns: Any) -> csr_array[np.float32]:
        """Return what the functions exchange as a sparse matrix (n, n)."""
        from scipy.sparse import coo_array

        basis, (even, odd) = self.camera, np.split(unknowns, 2)
        off = basis.first != basis.second
        rows = np.concatenate([basis.first, basis.second[off]])
        columns = np.concatenate([basis.second, basis.first[off]])
        values = np.concatenate([even + odd, (even - odd)[off]]).astype(np.float32)
        return coo_array((values, (rows, columns)), shape=(len(basis), len(basis))).tocsr()


@dataclass(frozen=True)
class Chart:
    """An image of which every camera ray sees a place, row and column in pixels, (rays, 2).

    Without places each ray is its own, and the shape is the camera's.
    """

    shape: tuple[int, ...]
    places: Double | None = None

    def basis(self, functions: Int32) -> MultiscaleBasis:
        """Return functions on the chart, over the camera's rays."""
        if self.places is None:
            return MultiscaleBasis(self.shape, functions)
        return ChartBasis(self.shape, functions, self.places)

    def cell_of(self, scale: int) -> Int64:
        """Return the number of the cell of a scale in which each camera ray lies, (rays,)."""
        (_, down, across), cell = RayDomain(self.shape).squares(scale)
        if self.places is None:
            return cell
        row, column = (self.places.T // scale).astype(np.int64)
        inside: Int64 = np.clip(row, 0, down - 1) * across + np.clip(column, 0, across - 1)
        return inside


class ChartBasis(MultiscaleBasis):
    """Functions on a chart; `weights` are for rays whose places, (rays, 2), lie on it."""

    def __init__(self, shape: tuple[int, ...], functions: Int32, places: Double) -> None:
        super().__init__(shape, functions)
        self.places = places

    @cached_property
    def weights(self) -> csr_array[np.float32]:
        """The functions' values at the rays' places, sparse float32 (rays, n)."""
        return self.at(self.places)

    def at(self, places: Double) -> csr_array[np.float32]:
        """Return the functions' values at places (rays, 2), sparse float32 (rays, n)."""
        from scipy.sparse import csr_array

        rays, owners, values = [], [], []
        last = np.asarray(self.shape[-2:]) - 1e-6
        for scale in np.unique(self.scales):
            (down, y), (across, x) = (
                along(axis, int(scale)) for axis in np.clip(places, 0, last).T
            )
            table = numbers(self.functions, self.shape, int(scale))[0]
            number = table[down[:, :, None], across[:, None, :]]
            value = y[:, :, None] * x[:, None, :]
            there = number >= 0
            rays.append(np.nonzero(there)[0])
            owners.append(number[there])
            values.append(value[there])
        where = (np.concatenate(rays), np.concatenate(owners))
        shape = (len(places), len(self))
        return csr_array((np.concatenate(values), where), shape=shape).astype(np.float32)


def chart_of(
    camera: RayDomain, middle: csr_array[np.float32], shape: tuple[int, int], floodlit: Float
) -> Chart:
    """Make a chart of a projector view's image (height, width).

    `middle` are the footprints on the view, (camera rays, rays of the view), `floodlit` the
    radiance when all of the view is lit. A ray's place is known where direct light is a part of the
    floodlit image, and of a typical ray's. The chart reaches beyond its view's image by half of its
    short side at most.
    """
    height, width = shape
    ray = np.arange(height * width)
    centre = np.stack([ray // width + 0.5, ray % width + 0.5], axis=1)
    light = np.asarray(middle.sum(axis=1), np.float64).ravel()
    places = (middle @ centre) / np.maximum(light, np.finfo(np.float32).tiny)[:, None]
    usual = float(np.median(light[light > 0])) if (light > 0).any() else 0.0
    known = (light > 0.3 * floodlit) & (light > 0.2 * usual)
    places = _carried_on(camera, places, known, np.array(shape))
    beyond = max(-places.min(), (places - shape).max(), 0.0)
    margin = int(min(np.ceil(beyond), np.floor(0.5 * min(shape))))
    return Chart((height + 2 * margin, width + 2 * margin), places + margin)


def _carried_on(
    camera: RayDomain, places: Double, known: NDArray[np.bool_], shape: NDArray[np.int64]
) -> Double:
    """Let rays of unknown place lie beside the nearest that is known, view by view."""
    views, height, width = camera.stack_shape
    # a camera's pixel as a place on the projector's image, were there no parallax
    row, column = np.indices((height, width)).reshape(2, -1) + 0.5
    expected = np.stack([row * shape[0] / height, column * shape[1] / width], axis=-1)
    aside = places.reshape(views, -1, 2) - expected
    for each, there in zip(aside, known.reshape(views, height, width), strict=True):
        each[:] = each[nearest(there)] if there.any() else 0
    carried: Double = (expected + aside).reshape(-1, 2)
    return carried
