"""Rooms of a few surfaces [thesis Fig. 2.1]: planes, wedges, corners, things that stand in them."""

from __future__ import annotations

from math import prod
from typing import Any, ClassVar, Self

from pydantic import Field, model_validator

from rfpipe.config.base import Extent, Settings
from rfpipe.config.scenes import SceneSettings
from rfpipe.scenes.base import Scene, SceneKind
from rfpipe.scenes.formfactors import DENSE_LIMIT
from rfpipe.scenes.kinds.diffuse import Diffuse, SurfaceName
from rfpipe.scenes.occluders import Occluder
from rfpipe.scenes.pinhole import Pinhole, Vector
from rfpipe.scenes.reference import aside_scene, planes_scene

__all__ = [
    "ColouredRoom",
    "ColouredRoomOptions",
    "Corner",
    "CornerOptions",
    "OccluderOptions",
    "Plane",
    "PlaneOptions",
    "ProjectorOptions",
    "SphereOnPlane",
    "SphereOptions",
    "SurfacesOptions",
    "TiltedWedge",
    "Wedge",
    "Wedge30",
    "Wedge120",
    "WedgeOptions",
]

_ENTRY_BYTES = 8
_ALBEDO = "white: albedo 0.8; texture: text-like strokes of albedo 0.15 and 0.85."


class OccluderOptions(Settings):
    """A black parallelogram that blocks light between surface points, and the camera's view."""

    centre: Vector = Field(
        description="Centre (x, y, z) in scene units; the camera is at the origin and looks "
        "along +z, the scene's surfaces are at z of about 1 to 3."
    )
    edge_u: Vector = Field(
        description="Vector from the centre to the middle of one edge, in scene units."
    )
    edge_v: Vector = Field(
        description="Vector from the centre to the middle of a neighbouring edge, in scene units; "
        "not parallel to edge_u."
    )

    @model_validator(mode="after")
    def _spans_a_parallelogram(self) -> Self:
        self.occluder()
        return self

    def occluder(self) -> Occluder:
        """Return it; raise InputError where the edges are parallel."""
        return Occluder(self.centre, self.edge_u, self.edge_v)


class ProjectorOptions(Settings):
    """A projector that stands elsewhere than the camera; its pixels are as wide as the camera's."""

    position: Vector = Field(
        description="Where it stands, (x, y, z) in scene units: the camera is at the origin, x to "
        "its right, y down, and looks along +z at the middle of the scene, [0, 0, 3]. At [1.72, 0, "
        "0.54] the projector looks at that from 35 degrees aside."
    )
    look_at: Vector = Field(
        (0.0, 0.0, 3.0), description="The point (x, y, z) at which it aims, in scene units."
    )
    shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width in pixels, 1 to 4096 each; null for as many as the camera's.",
    )

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        (x, _, z), (to_x, _, to_z) = self.position, self.look_at
        if (x, z) == (to_x, to_z):
            raise ValueError(
                "look_at should be another point than position, and not one straight above or below"
            )
        return self


class SurfacesOptions(Diffuse):
    """What rooms of a few surfaces have in common."""

    projector: ProjectorOptions | None = Field(
        None,
        description="The projector where it does not share the camera's rays, such as {position: "
        "[1.72, 0, 0.54]}, in front of all surfaces; null for a coaxial rig.",
    )

    occluders: tuple[OccluderOptions, ...] = Field(
        (), description="Parallelograms that block light between surfaces."
    )

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the projector's ray domain."""
        return (self.projector and self.projector.shape) or self.shape

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain."""
        return self.shape

    @property
    def is_coaxial(self) -> bool:
        """Whether camera and projector share their rays."""
        return self.projector is None

    @property
    def simulation_bytes(self) -> int:
        """Bytes of the form factors between surfaces that are seen by as many rays each."""
        share = (1 - 1 / len(self.surface_names)) / 2 if self.bounces > 1 else 0.0
        entries = share * prod(self.camera_ray_shape) ** 2
        return int(_ENTRY_BYTES * entries) if entries <= DENSE_LIMIT else 0


class PlaneOptions(SurfacesOptions):
    """One plane."""

    surface_names: ClassVar[tuple[str, ...]] = ("front",)
    surfaces: tuple[SurfaceName, ...] = Field(description=f"The plane. {_ALBEDO}")


class WedgeOptions(SurfacesOptions):
    """Two planes."""

    surface_names: ClassVar[tuple[str, ...]] = ("left", "right")
    surfaces: tuple[SurfaceName, ...] = Field(description=f"Left and right plane. {_ALBEDO}")


class CornerOptions(SurfacesOptions):
    """Three planes."""

    surface_names: ClassVar[tuple[str, ...]] = ("left", "right", "floor")
    surfaces: tuple[SurfaceName, ...] = Field(description=f"Left, right and floor. {_ALBEDO}")


class SphereOptions(SurfacesOptions):
    """A sphere and two planes."""

    surface_names: ClassVar[tuple[str, ...]] = ("floor", "wall", "sphere")
    surfaces: tuple[SurfaceName, ...] = Field(description=f"Floor, wall and sphere. {_ALBEDO}")


class ColouredRoomOptions(SurfacesOptions):
    """A room of five planes, a block and a sphere."""

    surface_names: ClassVar[tuple[str, ...]] = (
        *("left wall", "right wall", "floor", "ceiling", "back wall", "block", "sphere"),
    )
    surfaces: tuple[SurfaceName, ...] = Field(
        ("white", "white", "white", "white", "white", "white", "white"),
        description="Left wall, right wall, floor, ceiling, back wall, block and sphere, each in "
        f"its colour. {_ALBEDO}",
    )


class _Surfaces(SceneKind):
    """A room of `GEOMETRIES`."""

    geometry: ClassVar[str]

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:
        """Put up the surfaces."""
        room = options.arguments() | {
            "occluders": [each.occluder() for each in options.occluders],
            "compress": many_patterns or None,
        }
        if options.projector is None:
            return planes_scene(cls.geometry, **room)
        placed = options.projector
        projector = Pinhole(options.ray_shape, placed.position, placed.look_at)
        return aside_scene(cls.geometry, **room, projector=projector)


class Plane(_Surfaces):
    """One plane across the line of sight."""

    Options: ClassVar[type[SceneSettings]] = PlaneOptions
    geometry = "plane"


class Wedge(_Surfaces):
    """Two planes that meet at right angles in a concave edge, farthest from the camera."""

    Options: ClassVar[type[SceneSettings]] = WedgeOptions
    geometry = "wedge"


class Wedge30(Wedge):
    """Two planes that meet at 30 degrees."""

    geometry = "wedge_30"


class Wedge120(Wedge):
    """Two planes that meet at 120 degrees."""

    geometry = "wedge_120"


class TiltedWedge(Wedge):
    """A wedge whose edge is neither upright nor across the line of sight."""

    geometry = "tilted_wedge"


class Corner(_Surfaces):
    """Three planes at right angles, seen along the diagonal."""

    Options: ClassVar[type[SceneSettings]] = CornerOptions
    geometry = "corner"


class SphereOnPlane(_Surfaces):
    """A sphere on a floor before a wall."""

    Options: ClassVar[type[SceneSettings]] = SphereOptions
    geometry = "sphere_on_plane"


class ColouredRoom(_Surfaces):
    """A room with a red and a green wall, in which a white block and a golden sphere stand."""

    Options: ClassVar[type[SceneSettings]] = ColouredRoomOptions
    geometry = "coloured_room"
