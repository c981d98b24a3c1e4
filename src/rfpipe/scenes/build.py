"""From a scene's settings to the scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.scenes.base import Scene

if TYPE_CHECKING:
    from rfpipe.config import SceneSettings

__all__ = ["scene_from_config"]


def scene_from_config(settings: SceneSettings, *, many_patterns: bool = False) -> Scene:
    """Build the scene that settings describe.

    Parameters
    ----------
    settings
        Of any kind, such as ``SceneSettings.of("wedge", surfaces=("white", "texture"))``.
    many_patterns
        Whether thousands of patterns are to come, so that a slower preparation pays.

    Raises
    ------
    InputError
        When it is a captured scene, of which no light transport is known.
    """
    made: Scene = settings.subject.make(settings, many_patterns=many_patterns)
    return made
