"""Kinds of scenes with diffuse surfaces, including those of the thesis [Fig. 2.1, 5.8]."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from rfpipe.config.base import Extent, Settings
from rfpipe.config.scenes import SceneSettings, Views
from rfpipe.scenes.base import Scene
from rfpipe.scenes.geometries import GEOMETRIES, TINTS, surface_albedo, surface_names
from rfpipe.scenes.light_field import ROOM_SURFACES, room_scene
from rfpipe.scenes.noncoaxial import noncoaxial_scene
from rfpipe.scenes.pinholes import Pinhole, surface_points
from rfpipe.scenes.radiosity import DENSE_LIMIT, RadiosityScene
from rfpipe.scenes.surfaces import Occluder, Vector, is_occluded

REFERENCE_SCENES: dict[str, tuple[str, tuple[str, ...]]] = {
    "I": ("plane", ("texture",)),
    "II": ("wedge", ("white", "white")),
    "III": ("wedge", ("white", "texture")),
    "IV": ("wedge", ("texture", "texture")),
}
"""Geometry and surfaces of the scenes of Fig. 2.1."""

SpanDegrees = Annotated[float, Field(ge=0, le=45)]

_CONTRAST = 1.9  # maximum of direct light on white, relative to a pixel of mean area
_SURFACES = {name: surface_names(name) for name in GEOMETRIES} | {"room": ROOM_SURFACES}


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

    If parts of the room are much closer to the projector than its middle, the light is dimmed so
    that their radiance stays below 2, the full scale of the default camera.

    Parameters
    ----------
    geometry, surfaces
        A key of `GEOMETRIES`, and ``"white"`` or ``"texture"`` for each of its surface names.
    shape
        Height and width of the camera's image in pixels.
    projector
        A projector separate from the camera [Fig. 3.10]; None: a coaxial rig. Textures have the
        resolution of the camera, and are repeated beyond its image.
    channels
        1 (grey) or 3 (RGB).
    bounces
        1 is direct light only; each further one adds inter-reflection.
    occluders, seed
        Black parallelograms, and the seed of the textures.

    Raises
    ------
    InputError
        If the projector is behind a surface.
    """
    planes, camera = GEOMETRIES[geometry], Pinhole(shape)
    pages = _pages(geometry, surfaces, shape, channels, seed)
    options: dict[str, Any] = {"bounces": bounces, "occluders": occluders}
    name = f"{geometry} of {', '.join(surfaces)}"

    if projector is not None:

        def albedo_at(
            positions: NDArray[np.float64], surface: NDArray[np.int64]
        ) -> NDArray[np.float64]:
            pixel = np.nan_to_num(camera.project(positions))
            row, column = np.mod(np.floor(pixel), shape).astype(np.int64).T
            albedo: NDArray[np.float64] = pages[surface, row, column]
            return albedo

        options |= {"contrast": _CONTRAST, "name": f"{name}, lit from aside"}
        return noncoaxial_scene(planes, camera, projector, albedo_at, **options)

    points = surface_points(shape, planes)
    rays = np.arange(math.prod(shape))
    albedo = pages.reshape(len(planes), -1, channels)[points.surface, rays]
    albedo[is_occluded(camera.origin, points.positions, occluders)] = 0
    scale = points.mean_area
    if geometry not in ("plane", "wedge"):  # the scenes of the thesis are not dimmed
        scale *= min(1.0, _CONTRAST * float(points.areas.min()) / points.mean_area)
    return RadiosityScene(
        points,
        albedo.reshape(*shape, channels),
        scale=scale,
        name=name,
        pinholes=(camera,),
        **options,
    )


def _pages(
    geometry: str, surfaces: Sequence[str], shape: tuple[int, int], channels: int, seed: int
) -> NDArray[np.float64]:
    """Albedo of each surface at every pixel of the camera: float64 (surfaces, H, W, C)."""
    tints = TINTS.get(geometry, {})
    pages = {
        name: surface_albedo(kind, shape, channels, seed, index, tints.get(name))
        for index, (name, kind) in enumerate(zip(surface_names(geometry), surfaces, strict=True))
    }
    return np.stack([pages[surface.name] for surface in GEOMETRIES[geometry]])


def reference_scene(
    name: str, shape: tuple[int, int], *, channels: int = 3, bounces: int = 3, seed: int = 0
) -> RadiosityScene:
    """Build scene I, II, III or IV of Fig. 2.1, there of 310 x 350 pixels; see `planes_scene`."""
    geometry, surfaces = REFERENCE_SCENES[name]
    return planes_scene(geometry, surfaces, shape, channels=channels, bounces=bounces, seed=seed)


class ProjectorOptions(Settings):
    """A projector separate from the camera, with the same field of view."""

    position: Vector = Field(
        description="Position (x, y, z) in scene units; the camera is at the origin, with x to "
        "the right, y down, and looks along +z."
    )
    look_at: Vector = Field(
        (0.0, 0.0, 3.0), description="Point (x, y, z) on its optical axis, in scene units."
    )
    shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width in pixels; null for those of the camera.",
    )

    @model_validator(mode="after")
    def _looks_somewhere(self) -> Self:
        self.pinhole((1, 1))
        return self

    def pinhole(self, shape: tuple[int, int]) -> Pinhole:
        """Build the pinhole; InputError if `look_at` is its position, or straight up or down."""
        return Pinhole(self.shape or shape, self.position, self.look_at)


class Diffuse(SceneSettings):
    """Diffuse surfaces, white or textured, with inter-reflection."""

    surfaces: tuple[Literal["white", "texture"], ...] = Field(
        (),
        description="Each white (albedo 0.8) or texture (text-like strokes of albedo 0.15 on "
        "0.85), by default all white; in the order "
        + "; ".join(f"{kind}: {', '.join(names)}" for kind, names in _SURFACES.items())
        + ". The objects in the room are textured; room and coloured_room are coloured.",
    )
    bounces: Literal[1, 2, 3] = Field(
        3,
        description="Number of reflections: 1 is direct light only, 2 and 3 add inter-reflection.",
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

    def arguments(self, *further: str) -> dict[str, Any]:
        """Arguments of scenes of diffuse surfaces, by name, and of further options."""
        names = "surfaces", "shape", "channels", "bounces", "seed", *further
        return {name: getattr(self, name) for name in names}


class SurfacesOptions(Diffuse):
    """A scene of a few surfaces."""

    projector: ProjectorOptions | None = Field(
        None,
        description="A projector separate from the camera, such as {position: [1.72, 0, 0.54]}; "
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
        """True if camera and projector share their rays."""
        return self.projector is None

    @property
    def simulation_bytes(self) -> int:
        """Bytes of dense form factors, float64, if all surfaces cover the same number of rays."""
        share = (1 - 1 / len(self.surfaces)) / 2 if self.bounces > 1 else 0.0
        entries = share * math.prod(self.camera_ray_shape) ** 2
        return int(8 * entries) if entries <= DENSE_LIMIT else 0


class RoomOptions(Views, Diffuse):
    """The room with objects, seen by an array of views."""

    span_degrees: tuple[SpanDegrees, SpanDegrees] = Field(
        (37.0, 29.0),
        description="Angles between the outermost columns and rows of the array, in degrees, 0 "
        "to 45 each.",
    )


class _Surfaces(Scene):
    """Base class of the kinds of scene in `GEOMETRIES`."""

    Options: ClassVar[type[SceneSettings]] = SurfacesOptions

    @classmethod
    def make(cls, options: Any) -> Scene:
        """Build the scene."""
        projector = options.projector
        return planes_scene(
            options.kind,
            **options.arguments(),
            projector=projector and projector.pinhole(options.shape),
        )


class Plane(_Surfaces):
    """A plane perpendicular to the optical axis."""


class Wedge(_Surfaces):
    """Two planes that meet at right angles in a concave edge, farthest from the camera."""


class Wedge30(_Surfaces):
    """Two planes that meet at 30 degrees."""


class Wedge120(_Surfaces):
    """Two planes that meet at 120 degrees."""


class TiltedWedge(_Surfaces):
    """A wedge whose edge is neither vertical nor perpendicular to the optical axis."""


class Corner(_Surfaces):
    """Three planes at right angles, seen along the diagonal."""


class SphereOnPlane(_Surfaces):
    """A sphere on a floor in front of a wall."""


class ColouredRoom(_Surfaces):
    """A room with a red and a green wall, a white block and a golden sphere."""


class Room(Scene):
    """The corner of a room with a box, a poster and a card in it."""

    Options: ClassVar[type[SceneSettings]] = RoomOptions

    @classmethod
    def make(cls, options: Any) -> Scene:
        """Build the room."""
        return room_scene(**options.arguments("views", "span_degrees"))
