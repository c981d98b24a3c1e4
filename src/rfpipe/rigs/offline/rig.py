"""A rig that shows nothing itself: its pictures are taken by somebody, somewhere, and read in."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError, PicturesNeeded
from rfpipe.photometry.camera import sensor_from_config
from rfpipe.photometry.sensor import Sensor
from rfpipe.rigs.base import Key, check_patterns
from rfpipe.rigs.calibrated import load_calibration, resampled_sensor
from rfpipe.rigs.layout import DARK, ProjectorLayout

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig, OfflineConfig
    from rfpipe.photometry.resampling import Resampling

Float = NDArray[np.float32]


class OfflineRig:
    """A projector and a camera at the other end of a folder of pictures.

    Parameters
    ----------
    sensor : Sensor
        That of the camera.
    camera_shape, projector_shape : tuple of int
        The ray domains.
    channels : int
    layout : ProjectorLayout, optional
        Where the rays lie on the projector. None: each of its pixels is a ray.
    resampling : Resampling, optional
        How the camera's pictures become images on its rays. None: its pixels are its rays.

    Attributes
    ----------
    bracket : callable or None
        ``bracket(key, pattern)`` returns the frames of a pattern, or None where it wasn't taken;
        CaptureError where those of this key are of another pattern.

    Raises
    ------
    InputError
        When the parts don't fit together.
    """

    seconds_per_pattern = 0.0

    def __init__(
        self,
        sensor: Sensor,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        channels: int,
        layout: ProjectorLayout | None = None,
        resampling: Resampling | None = None,
    ) -> None:
        self.camera_shape, self.projector_shape = tuple(camera_shape), tuple(projector_shape)
        self.channels, self.layout = channels, layout
        self.bracket: Callable[[Key, Float], NDArray[Any] | None] | None = None
        for name, part, shape in (
            ("layout", layout, self.projector_shape),
            ("resampling", resampling, self.camera_shape),
        ):
            if part is not None and part.shape != shape:
                raise InputError(
                    f"the {name} is of {part.shape} rays; the scene's settings say {shape}. Set "
                    "them to those of the calibration"
                )
        self.camera_sensor = sensor
        self.sensor = resampled_sensor(sensor, resampling)
        self.picture_shape = RayDomain(self.camera_shape).picture_shape
        if resampling is not None:
            self.picture_shape = resampling.camera_shape
        self._frame_shape = self.sensor.frame_shape(self.camera_shape, channels)

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Return the brackets that were taken of patterns; see `rfpipe.rigs.Rig.capture`.

        Raises
        ------
        PicturesNeeded
            When those of some pattern are still to be taken.
        """
        patterns = check_patterns(patterns, keys, self.projector_shape)
        frames = np.empty((len(patterns), *self._frame_shape), self.sensor.frame_dtype)
        for index, (pattern, key) in enumerate(zip(patterns, keys, strict=True)):
            taken = self.bracket and self.bracket(tuple(key), pattern)
            if taken is None:
                raise PicturesNeeded(
                    f"the pictures of pattern {tuple(key)} are still to be taken: 'rfpipe "
                    "patterns' writes what to show, 'rfpipe import' reads what was taken"
                )
            frames[index] = taken.reshape(self._frame_shape)
        return frames

    def picture(self, pattern: Float) -> Float:
        """Return the projector's picture of a pattern, (Hp, Wp): views one above the other."""
        if self.layout is not None:
            return self.layout.picture(pattern)
        return np.reshape(pattern, RayDomain(self.projector_shape).picture_shape)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return {
            "kind": "offline",
            "layout": None if self.layout is None else self.layout.describe(),
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "channels": self.channels,
            "sensor": self.sensor.describe(),
        }


def offline_rig(
    config: OfflineConfig,
    camera: CameraConfig | None,
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    channels: int,
) -> OfflineRig:
    """Return the offline rig of a run's settings.

    Raises
    ------
    InputError
        When calibration, corners and shapes don't fit together.
    StoreError
        When the calibration can't be read.
    """
    layout = resampling = None
    if config.calibration is not None:
        known = load_calibration(Path(config.calibration))
        layout, resampling = known.layout, known.resampling
    if layout is None and config.projector_shape is not None:
        layout = ProjectorLayout.grid(config.projector_shape, projector_shape)
    if resampling is None and config.camera_corners is not None:
        assert config.picture_shape is not None  # the settings' model sees to it
        resampling = _within(config.camera_corners, camera_shape, config.picture_shape)
    return OfflineRig(
        sensor_from_config(camera), camera_shape, projector_shape, channels, layout, resampling
    )


def _within(corners: Any, shape: tuple[int, ...], picture_shape: tuple[int, int]) -> Resampling:
    """Return the resampling to means of the camera's pixels whose middles lie on a ray."""
    from scipy.sparse import csr_array

    from rfpipe.photometry.resampling import Resampling

    ray = ProjectorLayout.within(corners, shape, picture_shape).ray_of_pixel.ravel()
    pixels = np.flatnonzero(ray != DARK)
    count = np.bincount(ray[pixels], minlength=prod(shape))
    if not count.all():
        raise InputError(
            f"offline.camera_corners: {np.count_nonzero(count == 0)} of {prod(shape)} rays have no "
            f"pixel in pictures of {picture_shape}; check the corners, or take a smaller shape"
        )
    weights = (1 / count[ray[pixels]]).astype(np.float32)
    whole = prod(shape), prod(picture_shape)
    return Resampling(
        shape, picture_shape, csr_array((weights, (ray[pixels], pixels)), shape=whole)
    )
