"""The optical bench in software: a scene between a real window and a real camera driver.

The projector is a window on an X server in memory (Xvfb), or on an array where there is none. At
each trigger of the camera the display's pixels are read, sent through a scene to the camera's
picture, exposed with the camera's noise, and handed to the driver's emulated camera as its next
picture. All that stands around the scene is what a rig of hardware has: window, X server, camera
driver.
"""

from __future__ import annotations

import logging
import os
import shutil
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import plugins
from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError, ConfigError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.provenance import fingerprint
from rfpipe.rigs.devices import Camera, check_picture
from rfpipe.rigs.display import VirtualDisplay, memory_display
from rfpipe.rigs.geometry import centred_corners, tilted_corners
from rfpipe.rigs.optics import OpticalPath
from rfpipe.rigs.pylon import PylonCamera
from rfpipe.rigs.settings import calibration_of, sensor_of
from rfpipe.rigs.window import WindowProjector
from rfpipe.rigs.xvfb import XServer
from rfpipe.scenes import scene_from_config

if TYPE_CHECKING:
    from rfpipe.config import BenchConfig, RigConfig, SceneSettings

__all__ = ["BenchCamera", "BenchProjector", "Scenery", "View", "optical_path", "software_bench"]

Float = NDArray[np.float32]

SEQUENCE_PICTURES = 400
"""The most that the bench's projector takes, as many as a common one."""

PICTURES_DELAYED = 16
"""Pictures kept where light comes late."""

EMULATED_SERIAL = "0815-0000"
"""Of the driver's first emulated camera."""

PICTURES = "a.png", "b.png"
"""Two names, as the driver reads a single file only once; both are always the same picture."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Scenery:
    """What is before the camera of a bench, and the camera's true numbers.

    Parameters
    ----------
    display : VirtualDisplay
        Where the projector's window lies.
    offset : (int, int)
        Rows and columns of its upper left corner on the display.
    path : OpticalPath
    light_of_code : ndarray of float32, shape (256,)
        The projector's true response.
    camera : CameraModel
        Its noise, bits and mosaic; the exposures are those that the driver sets.
    seed : int
        Seed of the noise.
    delay_seconds : float
        From a picture's drawing to its light.
    drawn : sequence of (float, ndarray)
        Times, of `time.monotonic`, and codes of the last pictures drawn.
    knock : (int, int, int), optional
        Exposures before a knock against the projector, and the pixels down and to the right that
        its picture lies from then on.
    """

    display: VirtualDisplay
    offset: tuple[int, int]
    path: OpticalPath
    light_of_code: Float
    camera: CameraModel
    seed: int = 0
    delay_seconds: float = 0.0
    drawn: Sequence[tuple[float, NDArray[np.uint8]]] = ()
    knock: tuple[int, int, int] | None = None

    def codes(self) -> NDArray[np.uint8]:
        """Return what the projector lights now, (H, W): what its window shows, or showed."""
        lit = [
            codes
            for when, codes in tuple(self.drawn)
            if when <= time.monotonic() - self.delay_seconds
        ]
        return lit[-1] if self.delay_seconds and lit else self.window()

    def window(self) -> NDArray[np.uint8]:
        """Return what the window shows now, (H, W)."""
        (top, left), (height, width) = self.offset, self.path.projector_shape
        return self.display.pixels[top : top + height, left : left + width, 1].copy()

    def knocked(self, codes: NDArray[np.uint8], number: int) -> NDArray[np.uint8]:
        """Return codes as they are lit at an exposure: moved, from the knock on."""
        if self.knock is None or number <= self.knock[0]:
            return codes
        moved = np.zeros_like(codes)
        (rows, more_rows), (columns, more_columns) = map(_shifted, self.knock[1:])
        moved[rows, columns] = codes[more_rows, more_columns]
        return moved

    def radiance(self, codes: NDArray[np.uint8]) -> Float:
        """Return what the camera sees of a picture, (Hc, Wc, C)."""
        return self.path.radiance(self.light_of_code[codes])

    def frame(self, radiance: Float, exposure: float, number: int) -> NDArray[np.uint16]:
        """Return what the camera makes of it in `exposure` seconds: counts (Hc, Wc[, 3])."""
        camera = replace(self.camera, exposures=(exposure,))
        counts: NDArray[np.uint16] = camera.expose(radiance, self.seed, (number,))[0]
        return counts[..., 0] if counts.shape[2:] == (1,) else counts

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        numbers = self.camera.describe()
        del numbers["exposures"]  # the sensor's are taken
        return {
            "scene": self.path.describe(),
            "camera": numbers,
            "light_of_code": fingerprint(self.light_of_code),
            "seed": self.seed,
            **({} if self.knock is None else {"knock": list(self.knock)}),
        }


class View:
    """What a camera of the bench sees at each trigger, noise of its own in each frame.

    Parameters
    ----------
    scenery : Scenery
    """

    def __init__(self, scenery: Scenery) -> None:
        self.scenery = scenery
        self._number = 0
        self._seen: tuple[NDArray[np.uint8], Float] | None = None

    def frame(self, exposure: float) -> NDArray[np.uint16]:
        """Return the next frame, as `Scenery.frame`, of what the window shows now."""
        codes = self.scenery.knocked(self.scenery.codes(), self._number + 1)
        if self._seen is None or not np.array_equal(codes, self._seen[0]):
            self._seen = codes, self.scenery.radiance(codes)
        self._number += 1
        return self.scenery.frame(self._seen[1], exposure, self._number)


class BenchProjector(WindowProjector):
    """The window on the bench's display, which ends with it.

    Attributes
    ----------
    trigger : callable or None
        Triggers the bench's camera, where that is to be by the projector.
    scenery : Scenery or None
        What it lights.
    drawn : deque
        The last pictures, where their light comes late.
    """

    def __init__(self, display_shape: tuple[int, int], **settings: Any) -> None:
        with ExitStack() as stack:
            self.display = stack.enter_context(_display(display_shape))
            super().__init__(**{**settings, "display": self.display.name})
            self._server = stack.pop_all()
        self.trigger: Callable[[], None] | None = None
        self.scenery: Scenery | None = None
        self.drawn: deque[tuple[float, NDArray[np.uint8]]] = deque(maxlen=PICTURES_DELAYED)
        self._loaded: list[Float] = []

    def close(self) -> None:
        """Close the window and its display; closing twice is no error."""
        super().close()
        self._server.close()

    def show_now(self, picture: Float) -> None:
        """Show a picture, and return when it is drawn."""
        super().show_now(picture)
        if self.scenery is not None and self.scenery.delay_seconds:
            self.drawn.append((time.monotonic(), self.scenery.window()))

    @property
    def sequence_pictures(self) -> int:
        """The most pictures of a sequence, 0 where no camera is triggered."""
        return SEQUENCE_PICTURES if self.trigger is not None else 0

    def load(self, pictures: Iterable[Float]) -> None:
        """Take the pictures of a sequence; see `rfpipe.rigs.sequences.SequenceProjector`."""
        self._loaded = [check_picture(picture, self.shape) for picture in pictures]

    def play(self, order: Sequence[int], seconds: float) -> None:
        """Show a sequence as fast as the bench can, whose time isn't that of the exposures."""
        del seconds
        assert self.trigger is not None
        for place in order:
            self.show_now(self._loaded[place])
            self.trigger()

    def _before_opening(self) -> None:
        self.display.revive()
        self._display = self.display.name  # another server may have taken the one it had


class BenchCamera(PylonCamera):
    """The driver's emulated camera, each of its pictures made when it is triggered.

    Parameters
    ----------
    scenery : Scenery
    sensor : CameraModel
        What the rig believes of the camera; its exposures are set, its noise is not used.
    settings
        As `PylonCamera` has them; serial, shape and nodes are the bench's.

    Raises
    ------
    CaptureError
        When the emulated camera doesn't answer.
    """

    def __init__(self, scenery: Scenery, sensor: CameraModel, **settings: Any) -> None:
        os.environ.setdefault("PYLON_CAMEMU", "1")  # is read when the driver is loaded
        self._view = View(scenery)
        self._armed_for = 0.0
        self._folder = Path(tempfile.mkdtemp(prefix="rfpipe-bench-"))
        (self._folder / "pictures").mkdir()
        self._put(np.zeros(scenery.path.camera_shape, np.uint16))
        own = {
            "serial": EMULATED_SERIAL,
            "shape": scenery.path.camera_shape,
            "nodes": {
                "TestImageSelector": "Off",
                "ImageFilename": str(self._folder / "pictures"),
                "ImageFileMode": "On",
            },
        }
        try:
            super().__init__(sensor, **{**settings, **own})
        except CaptureError as error:
            self._clear()
            raise CaptureError(
                f"{error}. The bench needs pylon's emulated camera: set PYLON_CAMEMU=1 in the "
                "environment before pypylon is loaded"
            ) from error

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        described = {**super().describe(), "kind": "bench", "nodes": {}}
        return described | self._view.scenery.describe()

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        super().close()
        self._clear()

    def arm(self, exposure: float, count: int) -> None:
        """Wait for triggers by the bench's projector; see `SequenceCamera`."""
        super().arm(exposure, count)
        self._armed_for = exposure

    def trigger(self) -> None:
        """Take a frame while armed, as the projector's signal would have it."""
        patience = round(1000 * self._options.timeout_seconds)
        if self._camera.WaitForFrameTriggerReady(patience, self._pylon.TimeoutHandling_Return):
            self._before_trigger(self._armed_for)
            self._camera.ExecuteSoftwareTrigger()

    def _before_trigger(self, exposure: float) -> None:
        """Make the picture that the driver is about to read."""
        self._put(self._view.frame(exposure))

    def _put(self, counts: NDArray[np.uint16]) -> None:
        """Put counts before the emulated camera."""
        import cv2

        full_range = counts << np.uint16(16 - self._view.scenery.camera.bits)
        made = self._folder / "next.png"
        if not cv2.imwrite(str(made), full_range, [cv2.IMWRITE_PNG_COMPRESSION, 0]):
            raise CaptureError(f"{made}: can't be written; is the disk of {made.parent} full?")
        first, second = (self._folder / "pictures" / name for name in PICTURES)
        link = self._folder / "link.png"
        os.link(made, link)
        link.replace(first)
        made.replace(second)

    def _clear(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)


def software_bench(config: RigConfig) -> tuple[BenchProjector, Camera]:
    """Return the projector and the camera of a rig's bench.

    Parameters
    ----------
    config : RigConfig
        With a bench.

    Raises
    ------
    CaptureError
        When the camera's library is missing.
    InputError
        When the scene doesn't fit the display.
    """
    bench = config.bench
    assert bench is not None
    window = config.projector.arguments()
    if window["response"] is None:
        window["response"] = calibration_of(config).projector_response
    projector = BenchProjector(bench.display_shape, **window)
    try:
        true = sensor_from_config(bench.camera or config.sensor)
        assert isinstance(true, CameraModel)
        codes = np.linspace(0, 1, 256) ** bench.projector_gamma
        light = bench.projector_black + (1 - bench.projector_black) * codes
        scenery = Scenery(
            projector.display,
            window["offset"],
            optical_path(bench, projector.shape),
            light.astype(np.float32),
            true,
            config.seed,
            bench.display_delay_seconds,
            projector.drawn,
            bench.knock,
        )
        projector.scenery = scenery
        camera_of = plugins.find(plugins.CAMERAS, config.camera.bench or "")
        camera = camera_of(scenery, sensor_of(config), **config.camera.arguments())
        if getattr(camera, "can_be_triggered", False):
            projector.trigger = getattr(camera, "trigger", None)
        return projector, camera
    except BaseException:
        projector.close()
        raise


def _shifted(pixels: int) -> tuple[slice, slice]:
    """Return where moved pixels come to lie along an axis, and where they lay."""
    if pixels > 0:
        return slice(pixels, None), slice(None, -pixels)
    return slice(None, pixels or None), slice(-pixels, None)


def _display(shape: tuple[int, int]) -> AbstractContextManager[VirtualDisplay]:
    """Return the display nearest to a rig's that this machine can have."""
    if shutil.which("Xvfb"):
        _log.info("the bench's projector is a window of a real X server (Xvfb)")
        return XServer(shape, until_unused=True)
    _log.info(
        "the bench's projector is a window in memory, without an X server: Xvfb isn't installed "
        "(on Debian: apt-get install xvfb)"
    )
    return memory_display(shape)


def optical_path(bench: BenchConfig, projector_shape: tuple[int, int]) -> OpticalPath:
    """Return the light's way on a bench."""
    scene = scene_from_config(bench.scene)
    shape = scene.projector_shape
    views = bench.scene.view_grid
    return OpticalPath(
        scene,
        shape,
        projector_shape,
        bench.camera_shape,
        bench.projector_corners or centred_corners(shape, projector_shape, views),
        bench.camera_corners or tilted_corners(shape, bench.camera_shape, views),
        _direct_light(bench.scene),
        bench.ambient,
    )


def _direct_light(config: SceneSettings) -> Float:
    """Return the radiance (N, C) that each view sees of its own direct light."""
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
