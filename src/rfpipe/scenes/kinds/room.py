"""The room with things in it that an array of views looks at [thesis Fig. 5.8]."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import Field

from rfpipe.config.scenes import SceneSettings
from rfpipe.scenes.base import Scene, SceneKind
from rfpipe.scenes.kinds.diffuse import Diffuse, SurfaceName
from rfpipe.scenes.kinds.views import Views
from rfpipe.scenes.reference import room_scene

__all__ = ["Room", "RoomOptions"]

SpanDegrees = Annotated[float, Field(ge=0, le=45)]


class RoomOptions(Views, Diffuse):
    """The room, and the array of views before it."""

    surface_names: ClassVar[tuple[str, ...]] = ("left wall", "right wall", "floor")

    surfaces: tuple[SurfaceName, ...] = Field(
        description="Left wall, right wall and floor. white: albedo 0.8; texture: text-like "
        "strokes of albedo 0.15 and 0.85; all tinted, and the things in the room textured.",
    )
    span_degrees: tuple[SpanDegrees, SpanDegrees] = Field(
        (37.0, 29.0),
        description="Angles under which the outermost columns and rows of the array appear from "
        "the scene's centre, horizontally and vertically, in degrees, 0 to 45 each.",
    )


class Room(SceneKind):
    """The corner of a room with a box, a poster and a card in it."""

    Options: ClassVar[type[SceneSettings]] = RoomOptions

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:
        """Furnish the room."""
        return room_scene(
            **options.arguments(),
            views=options.views,
            span_degrees=options.span_degrees,
            compress=many_patterns or None,
        )
