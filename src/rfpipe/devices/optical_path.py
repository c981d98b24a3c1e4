"""Light of an optical bench, from projector pixels through a simulated scene to camera pixels."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.array_types import Double, Float
from rfpipe.blocks import RayDomain
from rfpipe.errors import ConfigError, InputError
from rfpipe.provenance import fingerprint
from rfpipe.rigs.layout import (
    DARK,
    ProjectorLayout,
    Quadrilateral,
    apply_homography,
    centred_corners,
    homography,
    lie_within,
    pixel_middles,
    tilted_corners,
)
from rfpipe.scenes import RadiosityScene, Scene, scene_from_config
from rfpipe.scenes.lenses import Lens, LensView, lens_points
from rfpipe.transport.operators import PatternOperator

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from rfpipe.config import BenchConfig, LensConfig, SceneSettings


SAMPLES = 8
"""Samples per camera pixel along each axis."""

_PIXELS_AT_A_TIME = 1024  # pixels whose samples are computed together, to save memory


class OpticalPath:
    """Light from projector pixels through a scene to camera pixels.

    Homographies map the scene's rays to patches of projector pixels and of camera pixels.
    Inter-reflection is computed from the mean light of each ray's projector pixels. With `direct`,
    direct light has the projector's full resolution: each camera sample is lit by the single
    projector pixel that illuminates its point of the scene.

    Parameters
    ----------
    scene : PatternOperator
        Light transport from a ray domain of N rays, `shape`, to itself.
    projector_corners, camera_corners : sequence of Quadrilateral
        Corners of each view's rays on the projector and on the camera, of `projector_shape` and
        `camera_shape` pixels.
    direct : ndarray, shape (N, C), optional
        Radiance of each ray due to direct light from its projector pixels.
    ambient : float
        Radiance of ambient light in every camera pixel.
    projector_lenses, camera_lenses : sequence of LensView
        A lens for each view; empty for pinholes.
    """

    def __init__(
        self,
        scene: PatternOperator,
        shape: tuple[int, ...],
        projector_shape: tuple[int, int],
        camera_shape: tuple[int, int],
        projector_corners: Sequence[Quadrilateral],
        camera_corners: Sequence[Quadrilateral],
        direct: NDArray[Any] | None = None,
        ambient: float = 0.0,
        projector_lenses: Sequence[LensView] = (),
        camera_lenses: Sequence[LensView] = (),
    ) -> None:
        self.shape, self.channels = shape, scene.channels
        self.projector_shape, self.camera_shape = projector_shape, camera_shape
        self._scene = scene
        self._ambient = np.float32(ambient)
        self._to_projector = [homography(shape, corners) for corners in projector_corners]
        self._to_camera = [homography(shape, corners) for corners in camera_corners]
        self.layout = ProjectorLayout.within(projector_corners, shape, projector_shape)
        self._rays = self.layout.ray_of_pixel.ravel()
        self._lit = self._rays != DARK
        self._pixels = self.layout.pixels_of_ray
        if not self._pixels.all():
            raise InputError(
                f"bench: {np.count_nonzero(self._pixels == 0)} of {prod(shape)} rays have no "
                f"projector pixel; {projector_shape} pixels are too few, or the corners lie outside"
            )
        self._direct = None if direct is None else np.asarray(direct, np.float32)
        self._projector_lenses, self._camera_lenses = tuple(projector_lenses), tuple(camera_lenses)
        self._sources = self._sources_of_pixels()
        self._sampling = self._sampling_matrix()

    def radiance(self, light: NDArray[Any]) -> Float:
        """Compute the radiance at the camera, float32 (*camera_shape, C).

        `light`, shape `projector_shape`, is the light of each projector pixel, at most 1.
        """
        dark = np.float32(0)  # at the last index
        pixel_light = np.append(np.asarray(light, np.float32), dark)[self._sources].mean(axis=0)
        rays = self._rays[self._lit]
        ray_light = np.bincount(rays, pixel_light, prod(self.shape)) / self._pixels
        image = self._scene.apply(ray_light[None].astype(np.float32))[0]
        points = np.zeros((self._rays.size, self.channels), np.float32)
        points[self._lit] = image[rays]
        if self._direct is not None:
            deviation = pixel_light - ray_light[rays].astype(np.float32)
            points[self._lit] += self._direct[rays] * deviation[:, None]
        picture: Float = self._sampling @ points
        return picture.reshape(*self.camera_shape, self.channels) + self._ambient

    def projector_points(self, camera_points: ArrayLike) -> NDArray[np.floating[Any]]:
        """Map camera points (..., 2) to the projector points that illuminate the same scene points.

        Both are (x, y) from the picture's corner, as in `Quadrilateral`; NaN outside all rays.
        """
        return self._seen(np.asarray(camera_points, np.float64), ())

    def _seen(self, points: Double, lenses: Sequence[LensView]) -> Double:
        """Map camera points (..., 2) to projector points.

        With lenses the first axis is that of the points of a lens, as in `LensView.seen`.
        """
        mapped = np.full(points.shape, np.nan)
        for view, to_projector in enumerate(self._to_projector):
            place = apply_homography(np.linalg.inv(self._to_camera[view]), points)
            if lenses:
                place = lenses[view].seen(place)
            inside = lie_within(place, RayDomain(self.shape).image_shape)
            mapped[inside] = apply_homography(to_projector, place[inside])
        return mapped

    def _sources_of_pixels(self) -> NDArray[np.int32]:
        """Projector pixels that light the surface at each lit pixel's centre: int32 (P, lit).

        One for each of the P points of a lens, 1 for a pinhole; the number of pixels where there
        is none.
        """
        lit = np.flatnonzero(self._lit)
        if not self._projector_lenses:
            return lit[None].astype(np.int32)
        middles = pixel_middles(self.projector_shape).reshape(-1, 2)[lit]
        view_of_pixel = self._rays[lit] // RayDomain(self.shape).rays_per_image
        sources = np.full((len(lens_points()), lit.size), self._rays.size, np.int32)
        for view, to_projector in enumerate(self._to_projector):
            pixels = np.flatnonzero(view_of_pixel == view)
            for part in np.array_split(pixels, -(-pixels.size // _PIXELS_AT_A_TIME)):
                place = apply_homography(np.linalg.inv(to_projector), middles[part])
                lighting = self._projector_lenses[view].lighting(place)
                target = apply_homography(to_projector, lighting)
                point, pixel = np.nonzero(lie_within(target, self.projector_shape))
                u, v = np.floor(target[point, pixel]).astype(np.int32).T
                sources[point, part[pixel]] = v * self.projector_shape[1] + u
        return sources

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the picture."""
        describe = getattr(self._scene, "describe", None)
        lenses = {"projector_lenses": self._projector_lenses, "camera_lenses": self._camera_lenses}
        return {
            "scene": describe() if describe else type(self._scene).__name__,
            "layout": self.layout.describe(),
            "to_camera": fingerprint(np.array(self._to_camera)),
            "camera_shape": list(self.camera_shape),
            "direct": None if self._direct is None else fingerprint(self._direct),
            "ambient": float(self._ambient),
            **{
                side: [list(view.lens) for view in views] for side, views in lenses.items() if views
            },
        }

    def _sampling_matrix(self) -> csr_array[Any]:
        """Sparse matrix that averages the radiance at projector pixels for each camera pixel."""
        from scipy.sparse import csr_array, vstack

        height, width = self.camera_shape
        columns = self.projector_shape[1]
        steps = (np.arange(SAMPLES) + 0.5) / SAMPLES
        count = len(lens_points()) if self._camera_lenses else SAMPLES
        # set k has a sample in each row and column of a pixel's grid; SAMPLES sets are all samples
        sets = steps[(3 * np.arange(SAMPLES) + np.arange(count)[:, None]) % SAMPLES]
        x = sets[:, None, :, None] + np.arange(width)
        weight = 1 / (count * SAMPLES)
        parts = []
        for rows in np.array_split(np.arange(height), -(-height * width // _PIXELS_AT_A_TIME)):
            y = (rows[:, None] + steps)[..., None]
            target = self._seen(np.stack(np.broadcast_arrays(x, y), axis=-1), self._camera_lenses)
            pixel = np.arange(rows.size * width).reshape(-1, 1, width)
            inside = lie_within(target, self.projector_shape)
            u, v = np.floor(target[inside]).astype(np.int64).T
            weights = np.full(u.size, weight, np.float32)
            places = np.broadcast_to(pixel, inside.shape)[inside], v * columns + u
            extent = (rows.size * width, prod(self.projector_shape))
            parts.append(csr_array((weights, places), shape=extent))
        return csr_array(vstack(parts, "csr"))


def optical_path(bench: BenchConfig) -> OpticalPath:
    """Build the optical path of a bench."""
    scene = scene_from_config(bench.scene)
    lenses = [_lenses(bench, scene, lens) for lens in (bench.projector_lens, bench.camera_lens)]
    shape = scene.projector_shape
    views = bench.scene.view_grid
    return OpticalPath(
        scene,
        shape,
        bench.display_shape,
        bench.camera_shape,
        centred_corners(shape, bench.display_shape, views),
        bench.camera_corners or tilted_corners(shape, bench.camera_shape, views),
        _direct_light(bench.scene),
        bench.ambient,
        *lenses,
    )


def _lenses(bench: BenchConfig, scene: Scene, lens: LensConfig | None) -> tuple[LensView, ...]:
    """Put a lens in the place of each pinhole of a scene; empty without aperture."""
    if lens is None or lens.aperture == 0:
        return ()
    if not isinstance(scene, RadiosityScene) or not scene.pinholes:
        raise ConfigError(
            f"bench.scene is of kind {bench.scene.kind}, whose depths are unknown, so that a lens "
            "can't defocus it; use plane, wedge or another kind of diffuse surfaces, or leave "
            "projector_lens and camera_lens out"
        )
    thin, surfaces = Lens(lens.aperture, lens.focus), scene.points.surfaces
    return tuple(LensView(thin, pinhole, surfaces) for pinhole in scene.pinholes)


def _direct_light(config: SceneSettings) -> Float:
    """Radiance (N, C) of each ray due to direct light, of one bounce."""
    if "bounces" not in type(config).model_fields:
        raise ConfigError(
            f"bench.scene is of kind {config.kind}, which has no option bounces to compute direct "
            "light; use plane, wedge or another kind with it"
        )
    scene = scene_from_config(config.model_copy(update={"bounces": 1}))
    domain = RayDomain(scene.projector_shape)
    light = np.repeat(np.eye(domain.views, dtype=np.float32), domain.rays_per_image, axis=1)
    images = np.asarray(scene.apply(light))
    return np.asarray(images[light == 1])  # in the order of the rays, view by view
