"""Pinholes and lenses, the start of paths, Russian roulette and sums of light, for all tracers.

Arguments are Dr.Jit arrays of a vectorised variant of Mitsuba.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe.mitsuba.views import Side


class Projection(NamedTuple):
    """Points projected into the pictures of views.

    Attributes
    ----------
    inside : Bool
        True where the point projects into the picture; it may still be occluded.
    pixel : UInt32
        Pixel in the ray domain of all views; 0 outside the picture.
    origin : Point3f
        Position of the view: of the pinhole, or of a random point on the lens.
    flux : Float
        ``1 / (cos^3 d^2)`` for a distance d and the cosine of the angle to the optical axis: flux
        per area perpendicular to the line of sight, for unit flux per area of the image plane at
        distance 1.
    """

    inside: Any
    pixel: Any
    origin: Any
    flux: Any


class Pinholes:
    """The pinholes of one side of the rig, as Dr.Jit arrays.

    A thin lens is a pinhole at random points of the lens, each with its picture shifted so that
    points in focus stay in place.
    """

    def __init__(self, side: Side) -> None:
        self.side, self.count = side, len(side.pinholes)
        frames = [[*pinhole.axes, pinhole.position] for pinhole in side.pinholes]
        self._frames = mi.Float(np.array(frames, dtype=np.float32).ravel())
        lenses = [(lens.aperture / 2, 1 / lens.focus) for lens in side.lenses]
        self._lenses = mi.Float(np.array(lenses, dtype=np.float32).ravel())

    def rays(self, pixel: Any, sampler: Any) -> Any:
        """Return rays through random points of pixels of all views."""
        within = sampler.next_2d()
        (height, width), pitch = self.side.shape, self.side.pitch
        view = pixel // (height * width)
        inside = pixel - view * (height * width)
        row = inside // width
        right, down, ahead, origin = self._frame(view)
        x = (mi.Float(inside - row * width) + within.x - width / 2) * pitch
        y = (mi.Float(row) + within.y - height / 2) * pitch
        direction = right * x + down * y + ahead
        if self.side.lenses:
            lens, shift = self._lens(view, sampler)
            origin = origin + right * lens.x + down * lens.y
            direction -= right * shift.x + down * shift.y
        return mi.Ray3f(mi.Point3f(origin), dr.normalize(direction))

    def project(self, point: Any, sampler: Any) -> Projection:
        """Project points into a random view."""
        view = dr.minimum(mi.UInt32(sampler.next_1d() * self.count), self.count - 1)
        (height, width), pitch = self.side.shape, self.side.pitch
        right, down, ahead, origin = self._frame(view)
        centre = mi.Vector2f(width / 2, height / 2)
        if self.side.lenses:
            lens, shift = self._lens(view, sampler)
            origin = origin + right * lens.x + down * lens.y
            centre += shift / pitch
        offset = mi.Vector3f(point) - origin
        depth = dr.dot(offset, ahead)
        column = centre.x + dr.dot(offset, right) / (depth * pitch)
        row = centre.y + dr.dot(offset, down) / (depth * pitch)
        inside = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        pixel = view * math.prod(self.side.shape) + mi.UInt32(row) * width + mi.UInt32(column)
        flux = dr.norm(offset) / (depth * depth * depth)
        return Projection(inside, dr.select(inside, pixel, 0), mi.Point3f(origin), flux)

    def _lens(self, view: Any, sampler: Any) -> tuple[Any, Any]:
        """Return random points on the lenses of views, and the shifts of the picture there.

        Both are Vector2f, to the right and down; shifts are on the image plane at distance 1.
        """
        radius, per_focus = (dr.gather(mi.Float, self._lenses, view * 2 + k) for k in range(2))
        unit: Any = mi.Vector2f(mi.warp.square_to_uniform_disk_concentric(sampler.next_2d()))
        return unit * radius, unit * (radius * per_focus)

    def _frame(self, view: Any) -> list[Any]:
        """Return the right, down and forward axes and the origins of views."""
        entries = [dr.gather(mi.Float, self._frames, view * 12 + k) for k in range(12)]
        return [mi.Vector3f(*entries[k : k + 3]) for k in range(0, 12, 3)]


class Sums:
    """Sums of light for consecutive rows, or columns, of a transport matrix.

    Double precision makes the order of additions by threads negligible.

    Parameters
    ----------
    first, count
        First pixel, and number of pixels, whose rows or columns these are.
    length
        Number of pixels on the opposite side: the length of each row or column.
    """

    def __init__(self, first: int, count: int, length: int) -> None:
        self.first, self.count, self.length = first, count, length
        self._values = dr.zeros(mi.Float64, count * length * 3)

    def add(self, row: Any, column: Any, colour: Any, active: Any) -> None:
        """Add colours to entries; `row` counts from the first pixel."""
        entry = (row * self.length + column) * 3
        for channel in range(3):
            value = mi.Float64(colour[channel])
            dr.scatter_reduce(dr.ReduceOp.Add, self._values, value, entry + channel, active)

    def flush(self) -> None:
        """Evaluate all pending additions."""
        dr.eval(self._values)

    def to_numpy(self) -> NDArray[np.float64]:
        """Return the sums, float64 (count, length, 3)."""
        values: NDArray[np.float64] = self._values.numpy()
        return values.reshape(self.count, self.length, 3)


class TracedScene(NamedTuple):
    """A scene of Mitsuba between cameras and projectors, and the maximum vertices of a path.

    Emitters of the scene are ignored. With 1 vertex, only direct light is traced.
    """

    scene: Any
    camera: Pinholes
    projector: Pinholes
    bounces: int


def begin(
    pinholes: Pinholes, first: int, count: int, samples: int, seed: int
) -> tuple[Any, Any, Any]:
    """Start `samples` paths through each of `count` pixels from `first` on.

    Returns the pixels' indices relative to `first`, the rays, and the random number generator.
    """
    lanes = count * samples
    row = dr.arange(mi.UInt32, lanes) // samples
    sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
    sampler.set_samples_per_wavefront(samples)
    sampler.seed(seed, lanes)
    pixel = row + dr.opaque(mi.UInt32, first)
    return row, pinholes.rays(pixel, sampler), sampler


def survival(weight: Any, bounces: Any) -> Any:
    """Probability that a path continues: Russian roulette by weight after 4 bounces."""
    return dr.select(bounces >= 4, dr.clip(dr.max(weight), 0.05, 0.95), mi.Float(1))


def is_specular(sample: Any) -> Any:
    """Test whether a sampled direction is that of a smooth mirror or lens."""
    kind = sample.sampled_type
    reflected = mi.has_flag(kind, mi.BSDFFlags.DeltaReflection)
    return reflected | mi.has_flag(kind, mi.BSDFFlags.DeltaTransmission)


def passes_straight(sample: Any) -> Any:
    """Test whether light passed a boundary without refraction, which is not counted as a bounce."""
    return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
