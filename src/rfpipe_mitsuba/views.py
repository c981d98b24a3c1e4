"""Where the cameras and the projectors of a physically based scene stand."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["Vector", "View", "Views"]

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class View:
    """A pinhole of square pixels at a place of its own, in the scene's frame.

    Parameters
    ----------
    origin, target
        Where it stands and at what it looks, in scene units.
    up
        What is up in its picture.
    degrees
        Its field of view across the picture's width, above 0 and below 180 degrees.

    Raises
    ------
    InputError
        If it looks at itself or along `up`, or the field of view is out of range.
    """

    origin: Vector
    target: Vector
    up: Vector = (0.0, 1.0, 0.0)
    degrees: float = 40.0

    def __post_init__(self) -> None:
        ahead = np.subtract(self.target, self.origin, dtype=np.float64)
        across = np.linalg.norm(np.cross(self.up, ahead))
        if not across > 1e-6 * np.linalg.norm(ahead) * np.linalg.norm(self.up):
            raise InputError(
                f"a view at {self.origin} looks at {self.target}, its up being {self.up}: expected "
                "another target, and an up that isn't along the line of sight"
            )
        if not 0 < self.degrees < 180:
            raise InputError(f"a field of view of {self.degrees} degrees: expected 0 to 180")

    @property
    def axes(self) -> NDArray[np.float64]:
        """Unit vectors to the picture's left, up and ahead: float64 (3, 3)."""
        ahead = np.subtract(self.target, self.origin, dtype=np.float64)
        ahead /= np.linalg.norm(ahead)
        left = np.cross(self.up, ahead)
        left /= np.linalg.norm(left)
        return np.stack([left, np.cross(ahead, left), ahead])


@dataclass(frozen=True)
class Views:
    """The pinholes of one side of a rig, which a ray domain (V, H, W), or (H, W), counts through.

    Parameters
    ----------
    views
        The pinholes, all of one field of view.
    shape
        Height and width of each of their pictures in pixels.

    Raises
    ------
    InputError
        If there is none, or their fields of view differ.
    """

    views: tuple[View, ...]
    shape: tuple[int, int]

    def __post_init__(self) -> None:
        if len({view.degrees for view in self.views}) != 1:
            raise InputError(
                f"{len(self.views)} views of one side of a rig: expected at least one, and all of "
                "the same field of view"
            )

    @property
    def pixels(self) -> int:
        """Number of pixels of each view."""
        return math.prod(self.shape)

    @property
    def rays(self) -> int:
        """Number of rays of all views."""
        return len(self.views) * self.pixels

    @property
    def pitch(self) -> float:
        """Side of a pixel at distance 1."""
        return 2 * math.tan(math.radians(self.views[0].degrees) / 2) / self.shape[1]

    @property
    def domain(self) -> tuple[int, ...]:
        """Shape of the ray domain: (H, W) of a single view, else (V, H, W)."""
        return self.shape if len(self.views) == 1 else (len(self.views), *self.shape)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints."""
        return asdict(self)
