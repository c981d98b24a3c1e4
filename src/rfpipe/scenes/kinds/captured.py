"""A real scene before a real rig."""

from __future__ import annotations

from typing import Any, ClassVar

from rfpipe.config.scenes import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes.base import Scene, SceneKind
from rfpipe.scenes.kinds.views import AnyRig

__all__ = ["Captured", "CapturedOptions"]


class CapturedOptions(AnyRig):
    """What is to be known of a real scene's rig."""

    is_captured: ClassVar[bool] = True


class Captured(SceneKind):
    """A real scene, whose light transport nobody knows."""

    Options: ClassVar[type[SceneSettings]] = CapturedOptions

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:  # noqa: ARG003
        """Raise InputError: there is nothing to simulate."""
        raise InputError(
            "a scene of kind captured can't be simulated; take plane, wedge or another"
        )
