"""A real scene before a real rig."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from rfpipe.config.base import Extent
from rfpipe.config.scenes import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes.base import Scene, SceneKind
from rfpipe.scenes.kinds.views import Views

__all__ = ["Captured", "CapturedOptions"]


class CapturedOptions(Views):
    """What is to be known of a real scene's rig."""

    is_captured: ClassVar[bool] = True

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


class Captured(SceneKind):
    """A real scene, whose light transport nobody knows."""

    Options: ClassVar[type[SceneSettings]] = CapturedOptions

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:  # noqa: ARG003
        """Raise InputError: there is nothing to simulate."""
        raise InputError(
            "a scene of kind captured can't be simulated; take plane, wedge or another"
        )
