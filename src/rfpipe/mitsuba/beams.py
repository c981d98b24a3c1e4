"""What all that Mitsuba traces has in common: pinholes, how paths begin and end, and their sums.

For the vectorised variant of Mitsuba: arguments are arrays of Dr.Jit.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe.mitsuba.views import Side


class Look(NamedTuple):
    """Points as views see them.

    Attributes
    ----------
    seen : Bool
        Whether the point is within the picture, ahead; it may be hidden.
    pixel : UInt32
        The pixel, in the ray domain of all views; 0 where it isn't seen.
    origin : Point3f
        Where the view stands.
    flux : Float
        ``1 / (cos^3 d^2)``, d being the distance, cos that of the angle to the optical axis: what
        falls on a unit of area across the line of sight, if a unit of area of the image plane at
        distance 1 sends, or takes, one.
    """

    seen: Any
    pixel: Any
    origin: Any
    flux: Any


class Pinholes:
    """The pinholes of a side, on the tracer's side."""

    def __init__(self, side: Side) -> None:
        self.side, self.count = side, len(side.pinholes)
        frames = [[*pinhole.axes, pinhole.position] for pinhole in side.pinholes]
        self._frames = mi.Float(np.array(frames, dtype=np.float32).ravel())

    def rays(self, pixel: Any, within: Any) -> Any:
        """Return rays through pixels of all views, at places (Point2f) within them, 0 to 1."""
        (height, width), pitch = self.side.shape, self.side.pitch
        view = pixel // (height * width)
        inside = pixel - view * (height * width)
        row = inside // width
        right, down, ahead, origin = self._frame(view)
        x = (mi.Float(inside - row * width) + within.x - width / 2) * pitch
        y = (mi.Float(row) + within.y - height / 2) * pitch
        return mi.Ray3f(mi.Point3f(origin), dr.normalize(right * x + down * y + ahead))

    def look(self, sample: Any, point: Any) -> Look:
        """Look points up in the picture of a view picked by a random number, any as likely."""
        view = dr.minimum(mi.UInt32(sample * self.count), self.count - 1)
        (height, width), pitch = self.side.shape, self.side.pitch
        right, down, ahead, origin = self._frame(view)
        way = mi.Vector3f(point) - origin
        depth = dr.dot(way, ahead)
        column = width / 2 + dr.dot(way, right) / (depth * pitch)
        row = height / 2 + dr.dot(way, down) / (depth * pitch)
        mask = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        pixel = view * math.prod(self.side.shape) + mi.UInt32(row) * width + mi.UInt32(column)
        flux = dr.norm(way) / (depth * depth * depth)
        return Look(mask, dr.select(mask, pixel, 0), mi.Point3f(origin), flux)

    def _frame(self, view: Any) -> list[Any]:
        """Return vectors to the right, down and ahead, and the origins, of views."""
        entries = [dr.gather(mi.Float, self._frames, view * 12 + k) for k in range(12)]
        return [mi.Vector3f(*entries[k : k + 3]) for k in range(0, 12, 3)]


class Sums:
    """Sums of light for some rows, or columns, of a transport matrix.

    In double precision, so that the order in which threads add hardly matters.

    Parameters
    ----------
    first, count
        The pixels whose rows, or columns, they are, in the order of their ray domain.
    others
        Number of pixels on the other side.
    """

    def __init__(self, first: int, count: int, others: int) -> None:
        self.first, self.count, self.others = first, count, others
        self._values = dr.zeros(mi.Float64, count * others * 3)

    def add(self, own: Any, other: Any, colour: Any, active: Any) -> None:
        """Add colours for `own` pixels, counted from the first, and `other` ones."""
        at = (own * self.others + other) * 3
        for channel in range(3):
            value = mi.Float64(colour[channel])
            dr.scatter_reduce(dr.ReduceOp.Add, self._values, value, at + channel, active)

    def flush(self) -> None:
        """Let what was added take place."""
        dr.eval(self._values)

    def to_numpy(self) -> NDArray[np.float64]:
        """Return the sums, float64 (count, others, 3)."""
        values: NDArray[np.float64] = self._values.numpy()
        return values.reshape(self.count, self.others, 3)


class Rig(NamedTuple):
    """Mitsuba's scene of surfaces between two sides, and the most vertices of a path of light.

    The scene's own emitters play no part; 1 vertex is direct light alone.
    """

    scene: Any
    camera: Pinholes
    projector: Pinholes
    bounces: int


def begin(
    pinholes: Pinholes, first: int, count: int, samples: int, seed: int
) -> tuple[Any, Any, Any]:
    """Begin paths, `samples` for each of `count` pixels from a first one on.

    Returns which of these pixels it is, counted from the first, rays, and random numbers.
    """
    lanes = count * samples
    row = dr.arange(mi.UInt32, lanes) // samples
    sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
    sampler.set_samples_per_wavefront(samples)
    sampler.seed(seed, lanes)
    pixel = row + dr.opaque(mi.UInt32, first)
    return row, pinholes.rays(pixel, sampler.next_2d()), sampler


def survival(weight: Any, done: Any) -> Any:
    """Probability that a path goes on (Russian roulette: dim ones may end from 4 bounces on)."""
    return dr.select(done >= 4, dr.clip(dr.max(weight), 0.05, 0.95), mi.Float(1))


def is_bent(sample: Any) -> Any:
    """Tell whether a surface turned light as a mirror or a lens does."""
    kind = sample.sampled_type
    reflected = mi.has_flag(kind, mi.BSDFFlags.DeltaReflection)
    return reflected | mi.has_flag(kind, mi.BSDFFlags.DeltaTransmission)


def is_unbent(sample: Any) -> Any:
    """Tell whether light passed a boundary straight on, which counts as no bounce."""
    return mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
