"""The optical bench in software: a scene between the projector's window and a real camera driver.

What the projector shows is drawn into an array in place of a display. At each trigger of the camera
it is sent through a scene to the camera's picture, exposed with the camera's noise, and handed to
the driver's virtual camera as its next picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import plugins
from rfpipe.blocks import RayDomain
from rfpipe.errors import ConfigError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.rigs.calibrated import calibration_of, sensor_of
from rfpipe.rigs.devices import Camera, check_picture
from rfpipe.rigs.layout import centred_corners, tilted_corners
from rfpipe.rigs.optics import OpticalPath, Scenery
from rfpipe.rigs.window import WindowProjector
from rfpipe.scenes import scene_from_config

if TYPE_CHECKING:
    from rfpipe.config import BenchConfig, RigConfig, SceneSettings

Float = NDArray[np.float32]


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


def software_bench(config: RigConfig) -> tuple[BenchProjector, Camera]:
    """Return the projector and the camera of a rig's bench.

    Raises
    ------
    CaptureError
        When the camera's library is missing.
    ConfigError
        When the projector's picture doesn't fit the display.
    InputError
        When the scene doesn't fit the picture.
    """
    bench = config.bench
    assert bench is not None
    window = config.projector.arguments()
    if window["response"] is None:
        window["response"] = calibration_of(config).projector_response
    true = sensor_from_config(bench.camera or config.sensor)
    assert isinstance(true, CameraModel)
    codes = np.linspace(0, 1, 256) ** bench.projector_gamma
    light = bench.projector_black + (1 - bench.projector_black) * codes
    scenery = Scenery(
        optical_path(bench, _picture_shape(bench, window)),
        light.astype(np.float32),
        true,
        config.seed,
        bench.display_delay_seconds,
        bench.knock,
    )
    projector = BenchProjector(scenery, **window)
    camera_of = plugins.find(plugins.CAMERAS, config.camera.bench or "")
    camera: Camera = camera_of(scenery, sensor_of(config), **config.camera.arguments())
    if getattr(camera, "can_be_triggered", False):
        projector.trigger = getattr(camera, "trigger", None)
    return projector, camera


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


def _picture_shape(bench: BenchConfig, window: dict[str, Any]) -> tuple[int, int]:
    """Return the extent of the projector's picture on the bench's display."""
    (height, width), (top, left) = bench.display_shape, window["offset"]
    rows, columns = window["shape"] or (height - top, width - left)
    if min(rows, columns) < 1 or top + rows > height or left + columns > width:
        raise ConfigError(
            f"projector.options: a picture of {(rows, columns)} pixels at {(top, left)} doesn't "
            f"fit on the bench's display of {(height, width)}; change bench.display_shape"
        )
    return rows, columns


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
