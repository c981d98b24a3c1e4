"""Pinholes: where a camera or a projector stands, and where its pixels look.

Lengths are in scene units. In the frame of rfpipe's own scenes x is to the right, y down, z ahead.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

Vector = tuple[float, float, float]
Double = NDArray[np.float64]


@dataclass(frozen=True)
class Pinhole:
    """A camera or a projector of square pixels.

    Parameters
    ----------
    shape
        Height and width in pixels, each at least 1.
    position
        Where it stands; the camera itself at the origin.
    look_at
        A point at which its optical axis aims. The picture's columns are as upright as may be.
    up
        What is up in its picture.
    width
        Of its image plane at distance 1; None where that plane's short side spans -0.5 to 0.5:
        53 degrees.

    Raises
    ------
    InputError
        If the shape isn't two positive numbers, or it looks at itself or along `up`.
    """

    shape: tuple[int, int]
    position: Vector = (0.0, 0.0, 0.0)
    look_at: Vector = (0.0, 0.0, 1.0)
    up: Vector = (0.0, -1.0, 0.0)
    width: float | None = None

    def __post_init__(self) -> None:
        if len(self.shape) != 2 or min(self.shape) < 1:
            raise InputError(
                f"scene shape {tuple(self.shape)}: expected height and width in pixels, each at "
                "least 1"
            )
        way = np.subtract(self.look_at, self.position, dtype=np.float64)
        across = np.linalg.norm(np.cross(self.up, way))
        if not across > 1e-6 * np.linalg.norm(way) * np.linalg.norm(self.up):  # 1e-6: rounding
            raise InputError(
                f"a pinhole at {self.position} looks at {self.look_at}, up being {self.up}: "
                "expected another point to look at, and not one straight above or below"
            )

    @property
    def pitch(self) -> float:
        """Side of a pixel at distance 1."""
        return 1 / min(self.shape) if self.width is None else self.width / self.shape[1]

    @property
    def origin(self) -> Double:
        """Its position as float64 (3,)."""
        return np.array(self.position, dtype=np.float64)

    @cached_property
    def axes(self) -> Double:
        """Unit vectors to the picture's right, down and ahead: float64 (3, 3)."""
        ahead = np.subtract(self.look_at, self.position, dtype=np.float64)
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, self.up)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(ahead, right), ahead])

    def rays(self, parts: int = 1) -> Double:
        """Directions of the pixels' parts, `parts` x `parts` each, as long as to distance 1.

        float64 (H W parts^2, 3), pixel by pixel.
        """
        height, width = self.shape
        within = (np.arange(parts) + 0.5) / parts
        image_plane = np.ones((height, width, parts, parts, 3))
        x, y = (
            (np.arange(length)[:, None] + within - length / 2) * self.pitch
            for length in (width, height)
        )
        image_plane[..., 0] = x[None, :, None, :]
        image_plane[..., 1] = y[:, None, :, None]
        return image_plane.reshape(-1, 3) @ self.axes

    def project(self, points: Double) -> Double:
        """Rows and columns at which points (n, 3) stand in the picture: float64 (n, 2).

        In pixels from its upper left corner; NaN for points that aren't ahead.
        """
        return self._place(points)[0] / self.pitch + np.array(self.shape) / 2

    def project_moves(self, points: Double, moves: Double) -> Double:
        """How far small moves (n, k, 3) of points (n, 3) go in the picture: float64 (n, k, 2)."""
        place, depth = self._place(points)
        turned = moves @ self.axes.T
        steps = turned[..., [1, 0]] - place[:, None] * turned[..., 2:]
        moved: Double = steps / (depth[:, None, None] * self.pitch)
        return moved

    def _place(self, points: Double) -> tuple[Double, Double]:
        """Points' places at distance 1, down and right (n, 2), and their depths (n,), or NaN."""
        right, down, ahead = ((points - self.origin) @ self.axes.T).T
        depth = np.where(ahead > 0, ahead, np.nan)
        return np.stack([down, right], axis=-1) / depth[:, None], depth
