"""The four scenes of [thesis Fig. 2.1], other rooms of planes, and the room of Fig. 5.8."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.aside import AsideScene
from rfpipe.scenes.geometries import GEOMETRIES, TINTS, names_of
from rfpipe.scenes.geometry import Surface, SurfacePoints, surface_points
from rfpipe.scenes.light_field import LightFieldScene
from rfpipe.scenes.occluders import Occluder
from rfpipe.scenes.pinhole import Pinhole
from rfpipe.scenes.radiosity import RadiosityScene
from rfpipe.scenes.room import room_panels
from rfpipe.scenes.textures import require_kinds, surface_albedo
from rfpipe.scenes.views import ViewArray

__all__ = ["REFERENCE_SCENES", "aside_scene", "planes_scene", "reference_scene", "room_scene"]

# Geometry and surfaces of the scenes of Fig. 2.1.
REFERENCE_SCENES: dict[str, tuple[str, tuple[str, ...]]] = {
    "I": ("plane", ("texture",)),
    "II": ("wedge", ("white", "white")),
    "III": ("wedge", ("white", "texture")),
    "IV": ("wedge", ("texture", "texture")),
}

_THESIS_ROOMS = ("plane", "wedge")
_CONTRAST = 1.9  # of direct light on white: the brightest pixel over one of mean area, at most


def planes_scene(
    geometry: str,
    surfaces: Sequence[str],
    shape: tuple[int, int],
    *,
    channels: int = 3,
    bounces: int = 3,
    occluders: Sequence[Occluder] = (),
    seed: int = 0,
    compress: bool | None = None,
) -> RadiosityScene:
    """Build a scene of white or textured surfaces.

    In rooms that reach much nearer to the rig than their middle, the projector's light is dimmed as
    far as the nearest pixels need to stay below a radiance of 2, the default camera's full scale.

    Parameters
    ----------
    geometry
        A key of `GEOMETRIES`, such as ``"wedge"`` or ``"corner"``.
    surfaces
        ``"white"`` or ``"texture"`` for each name of a surface, in the order of `GEOMETRIES`.
    shape
        Height and width of the ray domain in pixels.
    channels
        1 (grey) or 3 (RGB).
    bounces
        1 is direct light alone; each further one adds an inter-reflection.
    occluders
        Black parallelograms.
    seed
        Seed of the texture.
    compress
        Whether to compress the form factors; None decides by their number.

    Returns
    -------
    RadiosityScene

    Raises
    ------
    InputError
        For an unknown geometry or surface, a number of surfaces that doesn't fit the geometry, or
        settings out of range.
    """
    facing = _checked(geometry, surfaces)
    points = surface_points(shape, facing)
    pages = _pages(geometry, surfaces, points.shape, channels, seed)
    pages = pages.reshape(len(facing), -1, channels)
    albedo = pages[points.surface, np.arange(len(points.surface))]
    return RadiosityScene(
        points,
        albedo.reshape(*points.shape, channels),
        bounces=bounces,
        occluders=occluders,
        compress=compress,
        light=1.0 if geometry in _THESIS_ROOMS else _dimmed(points),
        name=f"{geometry} of {', '.join(surfaces)}",
    )


def aside_scene(
    geometry: str,
    surfaces: Sequence[str],
    shape: tuple[int, int],
    projector: Pinhole,
    *,
    channels: int = 3,
    bounces: int = 3,
    occluders: Sequence[Occluder] = (),
    seed: int = 0,
    compress: bool | None = None,
) -> AsideScene:
    """Build a scene whose projector does not share the camera's rays [Fig. 3.10].

    Textures are printed on the surfaces as `planes_scene` has them, pixel by pixel of the camera,
    and repeated beyond its image. The projector's light is dimmed as there.

    Parameters
    ----------
    geometry, surfaces, channels, bounces, occluders, seed, compress
        As for `planes_scene`.
    shape
        Height and width of the camera's image in pixels.
    projector
        Where the projector stands, and its pixels.

    Returns
    -------
    AsideScene

    Raises
    ------
    InputError
        As for `planes_scene`; and if the projector stands behind a surface.
    """
    facing = _checked(geometry, surfaces)
    camera = Pinhole(shape)
    pages = _pages(geometry, surfaces, shape, channels, seed)

    def albedo(positions: NDArray[np.float64], surface: NDArray[np.int64]) -> NDArray[np.float64]:
        place = np.nan_to_num(camera.project(positions))
        row, column = np.mod(np.floor(place), shape).astype(np.int64).T
        found: NDArray[np.float64] = pages[surface, row, column]
        return found

    return AsideScene(
        facing,
        camera,
        projector,
        albedo,
        bounces=bounces,
        occluders=occluders,
        compress=compress,
        contrast=_CONTRAST,
        name=f"{geometry} of {', '.join(surfaces)}, lit from aside",
    )


def _checked(geometry: str, surfaces: Sequence[str]) -> tuple[Surface, ...]:
    """Return the surfaces of a geometry; raise InputError where the settings don't fit it."""
    if geometry not in GEOMETRIES:
        raise InputError(f"geometry {geometry!r}: expected one of {', '.join(GEOMETRIES)}")
    require_kinds(surfaces, geometry, names_of(geometry))
    return GEOMETRIES[geometry]


def _pages(
    geometry: str, surfaces: Sequence[str], shape: tuple[int, int], channels: int, seed: int
) -> NDArray[np.float64]:
    """Albedo of each surface, as the camera would see it everywhere: (surfaces, H, W, C)."""
    tints = TINTS.get(geometry, {})
    pages = {
        name: surface_albedo(kind, shape, channels, seed, index, tints.get(name))
        for index, (name, kind) in enumerate(zip(names_of(geometry), surfaces, strict=True))
    }
    return np.stack([pages[surface.name] for surface in GEOMETRIES[geometry]])


def _dimmed(points: SurfacePoints) -> float:
    """Strength of light at which no white pixel is brighter than the contrast allows."""
    return min(1.0, _CONTRAST * float(points.areas.min()) / points.mean_area)


def reference_scene(
    name: str, shape: tuple[int, int], *, channels: int = 3, bounces: int = 3, seed: int = 0
) -> RadiosityScene:
    """Build scene I, II, III or IV of Fig. 2.1 at any resolution; 310 x 350 is the thesis'.

    Parameters
    ----------
    name
        ``"I"`` to ``"IV"``.
    shape, channels, bounces, seed
        As for `planes_scene`.

    Returns
    -------
    RadiosityScene

    Raises
    ------
    InputError
        For another name, or settings out of range.
    """
    if name not in REFERENCE_SCENES:
        raise InputError(f"reference scene {name!r}: expected one of {', '.join(REFERENCE_SCENES)}")
    geometry, surfaces = REFERENCE_SCENES[name]
    return planes_scene(geometry, surfaces, shape, channels=channels, bounces=bounces, seed=seed)


def room_scene(
    surfaces: Sequence[str],
    shape: tuple[int, int],
    *,
    views: tuple[int, int] | None = None,
    span_degrees: tuple[float, float] = (37.0, 29.0),
    channels: int = 3,
    bounces: int = 3,
    seed: int = 0,
    compress: bool | None = None,
) -> LightFieldScene:
    """Build the corner of a room with things in it, seen by an array of views [Fig. 5.8].

    Parameters
    ----------
    surfaces
        ``"white"`` or ``"texture"`` for left wall, right wall and floor.
    shape
        Height and width of a view in pixels; 130 x 200 is the thesis'.
    views
        Rows and columns of the array; 3 x 3 is the thesis'. One view, and a ray domain (H, W),
        where None.
    span_degrees
        Angles under which the array appears from the scene, horizontally and vertically.
    channels, bounces, seed, compress
        As for `planes_scene`.

    Returns
    -------
    LightFieldScene

    Raises
    ------
    InputError
        If a ray sees nothing, or settings are out of range.
    """
    return LightFieldScene(
        ViewArray(views, span_degrees, shape),
        room_panels(surfaces),
        channels=channels,
        bounces=bounces,
        seed=seed,
        compress=compress,
        name=f"room of {', '.join(surfaces)}",
    )
