"""The options of scenes that an array of views may look at."""

from __future__ import annotations

import math

from pydantic import Field

from rfpipe.config.base import Extent, ViewCount
from rfpipe.config.scenes import SceneSettings

__all__ = ["AnyRig", "Views"]


class Views(SceneSettings):
    """A scene before a planar array of coaxial projectors and cameras, or before a single pair."""

    views: tuple[ViewCount, ViewCount] | None = Field(
        None,
        description="The rig as a planar array of coaxial projectors and cameras, a light field "
        "[5.2]: rows and columns, 1 to 16 each; null for a single pair.",
    )

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the ray domain: (H, W) of a single pair, or (V, H, W)."""
        return self.shape if self.views is None else (math.prod(self.views), *self.shape)

    @property
    def view_grid(self) -> tuple[int, int]:
        """Rows and columns of the array of views, (1, 1) of a single pair."""
        return self.views or (1, 1)


class AnyRig(Views):
    """A scene before any rig, one whose camera stands aside of the projector, too."""

    camera_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of the camera's rays where the rig is not coaxial, 1 to 4096 "
        "each; null where camera and projector share their rays.",
    )

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain."""
        return self.ray_shape if self.camera_shape is None else self.camera_shape

    @property
    def is_coaxial(self) -> bool:
        """Whether camera and projector share their rays."""
        return self.camera_shape is None
