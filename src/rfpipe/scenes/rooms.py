"""Scenes of diffuse surfaces: those of [thesis Fig. 2.1], other rooms, and that of Fig. 5.8."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rfpipe.config.base import Extent, Settings
from rfpipe.config.scenes import SceneSettings, Views
from rfpipe.scenes.aside import aside_scene
from rfpipe.scenes.base import Scene
from rfpipe.scenes.geometries import GEOMETRIES, TINTS, names_of, surface_albedo
from rfpipe.scenes.light_field import ROOM_SURFACES, room_scene
from rfpipe.scenes.radiosity import DENSE_LIMIT, RadiosityScene
from rfpipe.scenes.sight import Pinhole, surface_points
from rfpipe.scenes.surfaces import Occluder, Vector, is_hidden

REFERENCE_SCENES: dict[str, tuple[str, tuple[str, ...]]] = {
    "I": ("plane", ("texture",)),
    "II": ("wedge", ("white", "white")),
    "III": ("wedge", ("white", "texture")),
    "IV": ("wedge", ("texture", "texture")),
}
"""Geometry and surfaces of the scenes of Fig. 2.1."""

SpanDegrees = Annotated[float, Field(ge=0, le=45)]

_CONTRAST = 1.9  # of direct light on white: the brightest pixel over one of mean area, at most
_SURFACES = {name: names_of(name) for name in GEOMETRIES} | {"room": ROOM_SURFACES}


def planes_scene(
    geometry: str,
    surfaces: Sequence[str],
    shape: tuple[int, int],
    *,
    projector: Pinhole | None = None,
    channels: int = 3,
    bounces: int = 3,
    occluders: Sequence[Occluder] = (),
    seed: int = 0,
) -> RadiosityScene:
    """Build a scene of white or textured surfaces.

    In rooms that reach much nearer to the projector than their middle, its light is dimmed as far
    as the nearest pixels need to stay below a radiance of 2, the default camera's full scale.

    Parameters
    ----------
    geometry, surfaces
        A key of `GEOMETRIES`, and ``"white"`` or ``"texture"`` for each name of its surfaces.
    shape
        Height and width of the camera's image in pixels.
    projector
        Where a projector stands that doesn't share the camera's rays, and its pixels [Fig. 3.10].
        Textures are printed pixel by pixel of the camera, and repeated beyond its image.
    channels
        1 (grey) or 3 (RGB).
    bounces
        1 is direct light alone; each further one adds an inter-reflection.
    occluders, seed
        Black parallelograms, and the seed of the texture.

    Raises
    ------
    InputError
        For a projector behind a surface.
    """
    facing, camera = GEOMETRIES[geometry], Pinhole(shape)
    tints = TINTS.get(geometry, {})
    printed = {
        name: surface_albedo(kind, shape, channels, seed, index, tints.get(name))
        for index, (name, kind) in enumerate(zip(names_of(geometry), surfaces, strict=True))
    }
    # of each surface, as the camera would see it everywhere
    pages = np.stack([printed[surface.name] for surface in facing])
    options: dict[str, Any] = {"bounces": bounces, "occluders": occluders}
    name = f"{geometry} of {', '.join(surfaces)}"

    if projector is not None:

        def albedo_at(
            positions: NDArray[np.float64], surface: NDArray[np.int64]
        ) -> NDArray[np.float64]:
            place = np.nan_to_num(camera.project(positions))
            row, column = np.mod(np.floor(place), shape).astype(np.int64).T
            albedo: NDArray[np.float64] = pages[surface, row, column]
            return albedo

        options |= {"contrast": _CONTRAST, "name": f"{name}, lit from aside"}
        return aside_scene(facing, camera, projector, albedo_at, **options)

    points = surface_points(shape, facing)
    rays = np.arange(math.prod(shape))
    albedo = pages.reshape(len(facing), -1, channels)[points.surface, rays]
    albedo[is_hidden(camera.origin, points.positions, occluders)] = 0
    scale = points.mean_area
    if geometry not in ("plane", "wedge"):  # the thesis' own
        scale *= min(1.0, _CONTRAST * float(points.areas.min()) / points.mean_area)
    return RadiosityScene(
        points, albedo.reshape(*shape, channels), scale=scale, name=name, **options
    )


def reference_scene(
    name: str, shape: tuple[int, int], *, channels: int = 3, bounces: int = 3, seed: int = 0
) -> RadiosityScene:
    """Build scene I, II, III or IV of Fig. 2.1 as `planes_scene` does; 310 x 350 is the thesis'."""
    geometry, surfaces = REFERENCE_SCENES[name]
    return planes_scene(geometry, surfaces, shape, channels=channels, bounces=bounces, seed=seed)


class ProjectorOptions(Settings):
    """A projector that stands elsewhere than the camera; its pixels are as wide as the camera's."""

    position: Vector = Field(
        description="Where it stands, (x, y, z) in scene units: the camera is at the origin, x "
        "to its right, y down, and looks along +z."
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
        self.pinhole((1, 1))
        return self

    def pinhole(self, shape: tuple[int, int]) -> Pinhole:
        """Return it; raise InputError where it looks at itself, or straight up or down."""
        return Pinhole(self.shape or shape, self.position, self.look_at)


class Diffuse(SceneSettings):
    """Diffuse surfaces, white or textured, and the light between them."""

    surfaces: tuple[Literal["white", "texture"], ...] = Field(
        (),
        description="Each white (albedo 0.8) or texture (text-like strokes of albedo 0.15 and "
        "0.85), all white where left out; in the order "
        + "; ".join(f"{kind}: {', '.join(names)}" for kind, names in _SURFACES.items())
        + ". The things in the room are textured; it and the coloured room have colours.",
    )
    bounces: Literal[1, 2, 3] = Field(
        3, description="Light simulated: 1 is direct light alone, 2 and 3 add inter-reflection."
    )
    seed: int = Field(0, ge=0, description="Seed of textures or paths of light, 0 or more.")

    @model_validator(mode="before")
    @classmethod
    def _all_white(cls, settings: Any) -> Any:
        if not isinstance(settings, Mapping) or "surfaces" in settings:
            return settings
        return {
            **settings,
            "surfaces": ("white",) * len(_SURFACES.get(str(settings.get("kind")), ())),
        }

    @model_validator(mode="after")
    def _has_all_surfaces(self) -> Self:
        names = _SURFACES.get(self.kind, ())
        if len(self.surfaces) != len(names) or not names:
            raise ValueError(
                f"kind {self.kind} should have {len(names)} surfaces ({', '.join(names)}), not "
                f"{len(self.surfaces)} ({', '.join(self.surfaces)})"
            )
        return self

    def arguments(self, *others: str) -> dict[str, Any]:
        """Return what a scene of diffuse surfaces is made with, by name, and other options."""
        names = "surfaces", "shape", "channels", "bounces", "seed", *others
        return {name: getattr(self, name) for name in names}


class SurfacesOptions(Diffuse):
    """A room of a few surfaces, before a camera and a projector."""

    projector: ProjectorOptions | None = Field(
        None,
        description="The projector aside of the camera, such as {position: [1.72, 0, 0.54]}; "
        "null: a coaxial rig.",
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
        """Bytes of the form factors, float64, between surfaces seen by as many rays each."""
        share = (1 - 1 / len(self.surfaces)) / 2 if self.bounces > 1 else 0.0
        entries = share * math.prod(self.camera_ray_shape) ** 2
        return int(8 * entries) if entries <= DENSE_LIMIT else 0


class RoomOptions(Views, Diffuse):
    """The room with things in it, and the array of views before it."""

    span_degrees: tuple[SpanDegrees, SpanDegrees] = Field(
        (37.0, 29.0),
        description="Angles between the outermost columns and rows of the array, in degrees, 0 "
        "to 45 each.",
    )


class _Surfaces(Scene):
    """A room of `GEOMETRIES`, as the kind is called."""

    Options: ClassVar[type[SceneSettings]] = SurfacesOptions

    @classmethod
    def make(cls, options: Any) -> Scene:
        """Put up the surfaces."""
        placed = options.projector
        return planes_scene(
            options.kind,
            **options.arguments(),
            projector=placed and placed.pinhole(options.shape),
        )


class Plane(_Surfaces):
    """One plane across the line of sight."""


class Wedge(_Surfaces):
    """Two planes that meet at right angles in a concave edge, farthest from the camera."""


class Wedge30(_Surfaces):
    """Two planes that meet at 30 degrees."""


class Wedge120(_Surfaces):
    """Two planes that meet at 120 degrees."""


class TiltedWedge(_Surfaces):
    """A wedge whose edge is neither upright nor across the line of sight."""


class Corner(_Surfaces):
    """Three planes at right angles, seen along the diagonal."""


class SphereOnPlane(_Surfaces):
    """A sphere on a floor before a wall."""


class ColouredRoom(_Surfaces):
    """A room with a red and a green wall, in which a white block and a golden sphere stand."""


class Room(Scene):
    """The corner of a room with a box, a poster and a card in it."""

    Options: ClassVar[type[SceneSettings]] = RoomOptions

    @classmethod
    def make(cls, options: Any) -> Scene:
        """Furnish the room."""
        return room_scene(**options.arguments("views", "span_degrees"))
