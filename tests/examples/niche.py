"""A user-defined radiosity scene in one file: a ball in a niche of bricks.

Lengths are in scene units: x to the right, y down, z ahead of the camera at the
origin; the shorter side of its picture spans -0.5 to 0.5 at z = 1.
"""

import numpy as np
from pydantic import Field

from rfpipe.config import SceneSettings
from rfpipe.scenes import Plane, RadiosityScene, Sphere, surface_points

SURFACES = (  # a plane: its name, one of its points, and a direction to the camera's side
    Plane("floor", (0, 0.9, 0), (0, -1, 0)),
    Plane("left", (-0.9, 0, 0), (1, 0, 0.2)),
    Plane("right", (0.9, 0, 0), (-1, 0, 0.2)),
    Plane("back", (0, 0, 3), (0, 0, -1)),
    Sphere("ball", (0.2, 0.5, 2.4), 0.4),
)


class NicheOptions(SceneSettings):
    """Options of the niche, besides the kind, shape, channels and methods of every scene."""

    brick: float = Field(0.3, gt=0, le=1, description="Height of a brick, scene units, 0 to 1.")


class Niche(RadiosityScene):
    """A ball in a niche of bricks."""

    Options = NicheOptions

    def __init__(self, options: NicheOptions) -> None:
        points = surface_points(options.shape, SURFACES)  # the surface that each pixel sees
        colours = albedo(points.positions, points.surface, options.brick)
        if options.channels == 1:
            colours = colours.mean(axis=1, keepdims=True)
        image = colours.reshape(*options.shape, options.channels)
        super().__init__(points, image, bounces=3, name="niche")


def albedo(positions, surface, brick=0.3):
    """Albedo (n, 3), below 1, at positions (n, 3) on surfaces (n,), by their index."""
    x, y, z = positions.T
    row = np.floor(y / brick)
    beside = ((x + z) / brick / 2 + row / 2) % 1
    is_joint = np.minimum(y / brick % 1, beside) < 0.1
    bricks = np.where(is_joint[:, None], (0.7, 0.7, 0.7), (0.6, 0.25, 0.15))
    return np.where((surface == 4)[:, None], (0.2, 0.3, 0.5), bricks)
