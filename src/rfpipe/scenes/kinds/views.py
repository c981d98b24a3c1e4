"""The options of scenes that an array of views may look at."""

from __future__ import annotations

import math

from pydantic import Field

from rfpipe.config.base import ViewCount
from rfpipe.config.scenes import SceneSettings

__all__ = ["Views"]


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
