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
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import plugins
from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError, ConfigError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.rigs.calibrated import calibration_of, sensor_of
from rfpipe.rigs.cameras.pylon import PylonCamera
from rfpipe.rigs.devices import Camera, check_picture
from rfpipe.rigs.displays import VirtualDisplay, XServer, memory_display
from rfpipe.rigs.geometry import centred_corners, tilted_corners
from rfpipe.rigs.optics import OpticalPath, Scenery
from rfpipe.rigs.window import WindowProjector
from rfpipe.scenes import scene_from_config

if TYPE_CHECKING:
    from rfpipe.config import BenchConfig, RigConfig, SceneSettings

Float = NDArray[np.float32]

_log = logging.getLogger(__name__)


class BenchProjector(WindowProjector):
    """The window on the bench's display, which ends with it.

    Attributes
    ----------
    trigger : callable or None
        Triggers the bench's camera, where that is to be by the projector.
    scenery : Scenery or None
        What it lights.
    """

    def __init__(self, display_shape: tuple[int, int], **settings: Any) -> None:
        with ExitStack() as stack:
            self.display = stack.enter_context(_display(display_shape))
            super().__init__(**{**settings, "display": self.display.name})
            self._server = stack.pop_all()
        self.trigger: Callable[[], None] | None = None
        self.scenery: Scenery | None = None
        self._loaded: list[Float] = []

    def close(self) -> None:
        """Close the window and its display; closing twice is no error."""
        super().close()
        self._server.close()

    def show_now(self, picture: Float) -> None:
        """Show a picture, and return when it is drawn."""
        super().show_now(picture)
        if self.scenery is not None:
            self.scenery.draw()

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

    def _before_opening(self) -> None:
        self.display.revive()
        self._display = self.display.name  # another server may have taken the one it had


class BenchCamera(PylonCamera):
    """The driver's emulated camera, each of its pictures made when it is triggered.

    Parameters
    ----------
    scenery : Scenery
    sensor : CameraModel
        The camera as the rig has it; its exposures are set, its noise is not used.
    options
        As `PylonCamera` has them; serial, shape and nodes are the bench's.

    Raises
    ------
    CaptureError
        When the emulated camera doesn't answer.
    """

    def __init__(self, scenery: Scenery, sensor: CameraModel, **options: Any) -> None:
        os.environ.setdefault("PYLON_CAMEMU", "1")  # is read when the driver is loaded
        self._scenery = scenery
        self._armed_for = 0.0
        self._folder = Path(tempfile.mkdtemp(prefix="rfpipe-bench-"))
        pictures = self._folder / "pictures"
        pictures.mkdir()
        self._put(np.zeros(scenery.path.camera_shape, np.uint16))
        own = {
            "serial": "0815-0000",  # of the driver's first emulated camera
            "shape": scenery.path.camera_shape,
            "nodes": {
                "TestImageSelector": "Off", "ImageFilename": str(pictures), "ImageFileMode": "On",
            },
        }  # fmt: skip
        try:
            super().__init__(sensor, **{**options, **own})
        except CaptureError as error:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise CaptureError(
                f"{error}. The bench needs pylon's emulated camera: set PYLON_CAMEMU=1 in the "
                "environment before pypylon is loaded"
            ) from error

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"kind": "bench", "nodes": {}} | self._scenery.describe()

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        super().close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def arm(self, exposure: float, count: int) -> None:
        """Wait for triggers by the bench's projector; see `SequenceCamera`."""
        super().arm(exposure, count)
        self._armed_for = exposure

    def trigger(self) -> None:
        """Take a frame while armed, as the projector's signal would have it."""
        if self._is_ready(self._options.timeout_seconds):
            self._before_trigger(self._armed_for)
            self._trigger()

    def _before_trigger(self, exposure: float) -> None:
        """Make the picture that the driver is about to read."""
        self._put(self._scenery.frame(exposure))

    def _put(self, counts: NDArray[np.uint16]) -> None:
        """Lay counts before the emulated camera: twice, as it reads a single file only once."""
        import cv2

        full_range = counts << np.uint16(16 - self._scenery.camera.bits)
        made, link = self._folder / "next.png", self._folder / "link.png"
        if not cv2.imwrite(str(made), full_range, [cv2.IMWRITE_PNG_COMPRESSION, 0]):
            raise CaptureError(f"{made}: can't be written; is the disk of {made.parent} full?")
        os.link(made, link)
        link.replace(self._folder / "pictures" / "a.png")
        made.replace(self._folder / "pictures" / "b.png")


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
