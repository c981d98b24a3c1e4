"""The optical bench in software: a scene between the projector's window and a real camera driver.

What the projector shows is drawn into an array in place of a display. At each trigger of the camera
it is sent through a scene to the camera's picture, exposed with the camera's noise, and handed to
the driver's virtual camera as its next picture.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from math import prod
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.blocks import RayDomain
from rfpipe.devices.pylon import PylonCamera
from rfpipe.devices.window import WindowProjector
from rfpipe.errors import CaptureError, ConfigError, InputError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.provenance import fingerprint
from rfpipe.rigs.calibrated import calibration_of, sensor_of
from rfpipe.rigs.devices import Camera, check_picture
from rfpipe.rigs.layout import (
    DARK,
    ProjectorLayout,
    Quadrilateral,
    apply_homography,
    centred_corners,
    homography,
    lie_within,
    tilted_corners,
)
from rfpipe.scenes import scene_from_config
from rfpipe.transport.operators import PatternOperator

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from rfpipe.config import BenchConfig, RigConfig, SceneSettings

Float = NDArray[np.float32]
Double = NDArray[np.floating[Any]]
Codes = NDArray[np.uint8]
Counts = NDArray[np.uint16]

SAMPLES = 8
"""Points a side at which each camera pixel looks into the scene."""


class OpticalPath:
    """A scene between a projector and a camera that each see its rays under a homography.

    A ray is the light between a projector's patch of pixels and the camera's patch, both at the
    same point of the scene. Inter-reflection comes from the mean light of each ray's projector
    pixels. Where `direct` is known, direct light keeps the projector's own resolution: a point of
    the scene that the camera sees is lit by the one projector pixel that aims at it.

    Parameters
    ----------
    scene : PatternOperator
        Light transport from a ray domain of N rays, `shape`, to itself.
    projector_corners, camera_corners : sequence of Quadrilateral
        Of each view's rays on the projector and on the camera, of `projector_shape` and
        `camera_shape` pixels.
    direct : ndarray, shape (N, C), optional
        Radiance of each ray that the light of its own projector pixels alone gives.
    ambient : float
        Radiance of other light in every camera pixel.
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
        self._seen = self._sampling()

    def radiance(self, light: NDArray[Any]) -> Float:
        """Return what the camera sees, float32 (*camera_shape, C).

        `light`, of the projector's shape, is that of each projector pixel, 1 at most.
        """
        of_pixels = np.asarray(light, np.float32).ravel()[self._lit]
        rays = self._rays[self._lit]
        of_rays = np.bincount(rays, of_pixels, prod(self.shape)) / self._pixels
        image = self._scene.apply(of_rays[None].astype(np.float32))[0]
        points = np.zeros((self._rays.size, self.channels), np.float32)
        points[self._lit] = image[rays]
        if self._direct is not None:
            beyond_mean = of_pixels - of_rays[rays].astype(np.float32)
            points[self._lit] += self._direct[rays] * beyond_mean[:, None]
        picture: Float = self._seen @ points
        return picture.reshape(*self.camera_shape, self.channels) + self._ambient

    def projector_points(self, camera_points: ArrayLike) -> Double:
        """Return where the projector aims at what the camera sees at points (..., 2).

        Both are (x, y) from the picture's corner, as in `Quadrilateral`; NaN where the camera sees
        no ray.
        """
        points = np.asarray(camera_points, np.float64)
        aimed = np.full(points.shape, np.nan)
        for to_camera, to_projector in zip(self._to_camera, self._to_projector, strict=True):
            place = apply_homography(np.linalg.inv(to_camera), points)
            inside = lie_within(place, RayDomain(self.shape).image_shape)
            aimed[inside] = apply_homography(to_projector, place[inside])
        return aimed

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes the picture."""
        describe = getattr(self._scene, "describe", None)
        return {
            "scene": describe() if describe else type(self._scene).__name__,
            "layout": self.layout.describe(),
            "to_camera": fingerprint(np.array(self._to_camera)),
            "camera_shape": list(self.camera_shape),
            "direct": None if self._direct is None else fingerprint(self._direct),
            "ambient": float(self._ambient),
        }

    def _sampling(self) -> csr_array[Any]:
        """Return the mean of the projector pixels' points that each camera pixel looks at."""
        from scipy.sparse import csr_array, vstack

        height, width = self.camera_shape
        columns = self.projector_shape[1]
        steps = (np.arange(SAMPLES) + 0.5) / SAMPLES
        x = (np.arange(width)[:, None] + steps).ravel()
        rows = []
        for row in range(height):
            points = np.stack(np.meshgrid(x, row + steps), axis=-1)
            target = self.projector_points(points).reshape(SAMPLES, width, SAMPLES, 2)
            pixel = np.broadcast_to(np.arange(width)[None, :, None], target.shape[:-1])
            inside = lie_within(target, self.projector_shape)
            u, v = np.floor(target[inside]).astype(np.int64).T
            weights = np.full(u.size, 1 / SAMPLES**2, np.float32)
            extent = (width, prod(self.projector_shape))
            rows.append(csr_array((weights, (pixel[inside], v * columns + u)), shape=extent))
        return csr_array(vstack(rows, "csr"))


class Scenery:
    """A bench's display, the scene before it, and the true numbers of the camera that looks.

    As a display it is drawn by `rfpipe.devices.window.WindowProjector`.

    Parameters
    ----------
    light_of_code : ndarray of float32, shape (256,)
        The projector's true response.
    camera : CameraModel
        Its noise, bits and mosaic; the exposures are those that the driver sets.
    delay_seconds : float
        From a picture's drawing to its light.
    knock : (int, int, int), optional
        Exposures before a knock against the projector, and the pixels down and to the right that
        its picture lies from then on.

    Attributes
    ----------
    codes : ndarray of uint8, shape path.projector_shape
        The picture that was drawn last.
    """

    def __init__(
        self,
        path: OpticalPath,
        light_of_code: Float,
        camera: CameraModel,
        seed: int = 0,
        delay_seconds: float = 0.0,
        knock: tuple[int, int, int] | None = None,
    ) -> None:
        self.path, self.camera = path, camera
        self.shape = path.projector_shape
        self.codes: Codes = np.zeros(self.shape, np.uint8)
        self._light, self._seed = light_of_code, seed
        self._delay, self._knock = delay_seconds, knock
        self._drawn: deque[tuple[float, Codes]] = deque(maxlen=16)
        self._number = 0
        self._seen: tuple[Codes, Float] | None = None

    def draw(self, codes: Codes) -> None:
        """Draw a picture; its light may come late."""
        self.codes = codes
        self._drawn.append((time.monotonic(), codes))

    def is_undisturbed(self) -> bool:
        """Nothing else is drawn on this display."""
        return True

    def close(self) -> None:
        """Leave the display as it is."""

    def frame(self, exposure: float) -> Counts:
        """Return the counts (Hc, Wc[, 3]) of the next frame, each with noise of its own."""
        self._number += 1
        codes = self._lit()
        if self._seen is None or not np.array_equal(codes, self._seen[0]):
            self._seen = codes, self._radiance(codes)
        camera = replace(self.camera, exposures=(exposure,))
        counts: Counts = camera.expose(self._seen[1], self._seed, (self._number,))[0]
        return counts[..., 0] if counts.shape[2:] == (1,) else counts

    def _radiance(self, codes: Codes) -> Float:
        """Return what the camera sees under codes (H, W), or (H, W, 3) of red, green and blue."""
        light = self._light[codes]
        if codes.ndim == 2:
            return self.path.radiance(light)
        each = [self.path.radiance(light[..., colour]) for colour in range(3)]
        channels = range(self.path.channels)
        return np.stack([each[channel][..., channel] for channel in channels], axis=-1)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        numbers = self.camera.describe()
        del numbers["exposures"]  # the sensor's are taken
        return {
            "scene": self.path.describe(),
            "camera": numbers,
            "light_of_code": fingerprint(self._light),
            "seed": self._seed,
            **({} if self._knock is None else {"knock": list(self._knock)}),
        }

    def _lit(self) -> Codes:
        """Return the codes that are lit now: those drawn, late or moved by a knock."""
        drawn, lit_since = tuple(self._drawn), time.monotonic() - self._delay
        late = (codes for when, codes in drawn[::-1] if when <= lit_since)
        codes = next(late, drawn[0][1] if drawn else self.codes)
        if self._knock is None or self._number <= self._knock[0]:
            return codes
        from scipy.ndimage import shift

        moved: Codes = shift(codes, (*self._knock[1:], 0)[: codes.ndim], order=0)
        return moved


class BenchProjector(WindowProjector):
    """The projector whose pictures are drawn before a scenery, which the bench's camera looks at.

    `trigger` triggers that camera in sequences, where that is to be by the projector; else None.
    """

    def __init__(self, scenery: Scenery, **settings: Any) -> None:
        self.scenery = scenery
        super().__init__(**settings)
        self.trigger: Callable[[], None] | None = None
        self._loaded: list[Float] = []

    def _open(self) -> Scenery:
        return self.scenery

    @property
    def sequence_pictures(self) -> int:
        """The most pictures of a sequence, as many as a common one's; 0 without a trigger."""
        return 400 if self.trigger is not None else 0

    def load(self, pictures: Iterable[Float]) -> None:
        """Take the pictures of a sequence; see `rfpipe.rigs.devices.SequenceProjector`."""
        self._loaded = [check_picture(picture, self.shape) for picture in pictures]

    def play(self, order: Sequence[int], seconds: float) -> None:  # noqa: ARG002
        """Show a sequence as fast as the bench can, whose time isn't that of the exposures."""
        assert self.trigger is not None
        for place in order:
            self.show_now(self._loaded[place])
            self.trigger()


class PylonBenchCamera(PylonCamera):
    """The driver's emulated camera on the bench in software, its pictures read from files.

    The exposures of `sensor` are set, its noise is not used; what says which camera it is, and the
    frames' shape, is the bench's.
    """

    kind = "bench"

    def __init__(self, scenery: Scenery, sensor: CameraModel, **options: Any) -> None:
        os.environ.setdefault("PYLON_CAMEMU", "1")  # is read when the driver is loaded
        self._scenery = scenery
        folder = mkdtemp(prefix="rfpipe-bench-")
        self._remove = finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._folder = Path(folder)
        pictures = self._folder / "pictures"
        pictures.mkdir()
        self._put(np.zeros(scenery.path.camera_shape, np.uint16), scenery.camera.bits)
        overrides = {
            "serial": "0815-0000",  # of the driver's first emulated camera
            "shape": scenery.path.camera_shape,
            "nodes": {
                "TestImageSelector": "Off", "ImageFilename": str(pictures), "ImageFileMode": "On",
            },
        }  # fmt: skip
        try:
            super().__init__(sensor, **{**options, **overrides})
        except CaptureError as error:
            raise CaptureError(
                f"{error}. The bench needs pylon's emulated camera: set PYLON_CAMEMU=1 in the "
                "environment before pypylon is loaded"
            ) from error

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"nodes": {}} | self._scenery.describe()

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        super().close()
        self._remove()

    def trigger(self) -> None:
        """Take a frame while armed, as the projector's signal would have it."""
        if self._armed is not None and self._is_ready(self._options.timeout_seconds):
            self._before_trigger(self._armed[0])
            self._trigger()

    def _before_trigger(self, exposure: float) -> None:
        self._put(self._scenery.frame(exposure), self._scenery.camera.bits)

    def _put(self, counts: Counts, bits: int) -> None:
        """Lay counts before the emulated camera: twice, as it reads a single file only once."""
        import cv2

        path, link = self._folder / "next.png", self._folder / "link.png"
        full_range = counts << np.uint16(16 - bits)
        if not cv2.imwrite(str(path), full_range, [cv2.IMWRITE_PNG_COMPRESSION, 0]):
            raise CaptureError(f"{path}: can't be written; is the disk of {path.parent} full?")
        os.link(path, link)
        link.replace(self._folder / "pictures" / "a.png")
        path.replace(self._folder / "pictures" / "b.png")


def software_bench(config: RigConfig) -> tuple[BenchProjector, Camera]:
    """Return the projector and the camera of a rig's bench; CaptureError without its library."""
    bench = config.bench
    assert bench is not None
    true = sensor_from_config(bench.camera or config.sensor)
    assert isinstance(true, CameraModel)
    codes = np.linspace(0, 1, 256) ** bench.projector_gamma
    light = bench.projector_black + (1 - bench.projector_black) * codes
    scenery = Scenery(
        optical_path(bench),
        light.astype(np.float32),
        true,
        config.seed,
        bench.display_delay_seconds,
        bench.knock,
    )
    response = calibration_of(config).projector_response
    projector = BenchProjector(scenery, response=response, **dict(config.projector.options))
    camera = PylonBenchCamera(scenery, sensor_of(config), **dict(config.camera.options))
    if camera.can_be_triggered:
        projector.trigger = camera.trigger
    return projector, camera


def optical_path(bench: BenchConfig) -> OpticalPath:
    """Return the light's way on a bench."""
    scene = scene_from_config(bench.scene)
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
    )


def _direct_light(config: SceneSettings) -> Float:
    """Return the radiance (N, C) of each ray by its own direct light alone."""
    if "bounces" not in type(config).model_fields:
        raise ConfigError(
            f"bench.scene is of kind {config.kind}, which doesn't tell direct light by an option "
            "bounces; take plane, wedge or another"
        )
    scene = scene_from_config(config.model_copy(update={"bounces": 1}))
    domain = RayDomain(scene.projector_shape)
    light = np.repeat(np.eye(domain.views, dtype=np.float32), domain.rays_per_image, axis=1)
    images = np.asarray(scene.apply(light))
    return np.asarray(images[light == 1])  # view by view, as the rays are ordered
