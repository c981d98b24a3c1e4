"""Rays through the pixels of a side's views, and points looked up in their pictures.

For the vectorised variant of Mitsuba: every argument is an array of Dr.Jit.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from rfpipe_mitsuba.views import Views

__all__ = ["Look", "Pinholes"]


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
    """The views of a side, on the tracer's side."""

    def __init__(self, views: Views) -> None:
        self.views = views
        frames = [[*view.axes, view.origin] for view in views.views]
        self._frames = mi.Float(np.array(frames, dtype=np.float32).ravel())

    def rays(self, pixel: Any, within: Any) -> Any:
        """Return rays through pixels of all views, at places (Point2f) within them, 0 to 1."""
        (height, width), each = self.views.shape, self.views.pixels
        view = pixel // each
        inside = pixel - view * each
        row = inside // width
        left, up, ahead, origin = self._frame(view)
        x = (width / 2 - (mi.Float(inside - row * width) + within.x)) * self.views.pitch
        y = (height / 2 - (mi.Float(row) + within.y)) * self.views.pitch
        return mi.Ray3f(mi.Point3f(origin), dr.normalize(left * x + up * y + ahead))

    def look(self, view: Any, point: Any) -> Look:
        """Look points up in the pictures of views."""
        (height, width), pitch = self.views.shape, self.views.pitch
        left, up, ahead, origin = self._frame(view)
        way = mi.Vector3f(point) - origin
        depth = dr.dot(way, ahead)
        column = width / 2 - dr.dot(way, left) / (depth * pitch)
        row = height / 2 - dr.dot(way, up) / (depth * pitch)
        seen = (depth > 0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        pixel = view * self.views.pixels + mi.UInt32(row) * width + mi.UInt32(column)
        flux = dr.norm(way) / (depth * depth * depth)
        return Look(seen, dr.select(seen, pixel, 0), mi.Point3f(origin), flux)

    def choose(self, sample: Any) -> Any:
        """Return one of the views by a random number, each as likely as the others."""
        count = len(self.views.views)
        return dr.minimum(mi.UInt32(sample * count), count - 1)

    def _frame(self, view: Any) -> list[Any]:
        """Return vectors to the left, up and ahead, and the origins, of views."""
        entries = [dr.gather(mi.Float, self._frames, view * 12 + k) for k in range(12)]
        return [mi.Vector3f(*entries[k : k + 3]) for k in range(0, 12, 3)]
