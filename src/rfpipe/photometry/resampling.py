"""Resampling of merged images from camera pixels to rays, and a sensor that applies it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.photometry.demosaic import filling, weighed
from rfpipe.photometry.sensor import BracketMerge, ExactSensor, MergedImages, Sensor
from rfpipe.provenance import fingerprint
from rfpipe.units import RADIANCE, picture_name

if TYPE_CHECKING:
    from scipy.sparse import csr_array


LEAST_WEIGHT = 0.1
"""Smallest weight of a ray's pixels without defects, of 1, with which the ray is still visible."""

_PREFIX = "resampling_"


@dataclass(frozen=True, eq=False)
class Resampling:
    """Weights of the camera's pixels in each ray.

    A ray that the camera doesn't see has no weights: its radiance and variance are 0, so that it is
    never significant. For ``T`` to be symmetric, it must not be lit, either: a calibrated layout
    keeps its projector pixels dark.

    Parameters
    ----------
    shape : tuple of int
        Shape of the ray domain, see `RayDomain`.
    camera_shape : tuple of int
        Shape of the camera's frames, (Hc, Wc).
    matrix : csr_array of float32, shape (rays, camera pixels)
        Both in row-major order. Each row sums to 1, or is empty for a ray that is not visible.
        Weights may be negative where neighbouring rays share camera pixels.
    """

    shape: tuple[int, ...]
    camera_shape: tuple[int, int]
    matrix: csr_array[Any]

    @property
    def visible(self) -> NDArray[np.bool_]:
        """Mask of the rays that the camera sees, shape `shape`."""
        return np.asarray(np.diff(self.matrix.indptr) > 0).reshape(self.shape)

    def without(self, pixels: NDArray[np.bool_]) -> Resampling:
        """Exclude camera pixels, given as a mask of shape `camera_shape`.

        The weights of a ray's remaining pixels are scaled up; a ray with too few is not visible.
        """
        from scipy.sparse import csr_array, diags_array

        weights = csr_array(self.matrix @ diags_array((~pixels.ravel()).astype(np.float32)))
        weights.eliminate_zeros()
        enough = np.asarray(weights.sum(axis=1)) >= LEAST_WEIGHT
        weights = csr_array(diags_array(enough.astype(np.float32)) @ weights)
        return replace(self, matrix=normalised(weights))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays for storage; see `from_arrays`."""
        return {
            f"{_PREFIX}shape": np.array(self.shape, np.int32),
            f"{_PREFIX}camera_shape": np.array(self.camera_shape, np.int32),
            f"{_PREFIX}starts": self.matrix.indptr.astype(np.int64),
            f"{_PREFIX}pixels": self.matrix.indices.astype(np.int32),
            f"{_PREFIX}weights": self.matrix.data.astype(np.float32),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Resampling:
        """Restore a resampling from its `arrays`."""
        from scipy.sparse import csr_array

        shape, camera, starts, pixels, weights = (
            arrays[f"{_PREFIX}{name}"]
            for name in ("shape", "camera_shape", "starts", "pixels", "weights")
        )
        height, width = map(int, camera)
        rays = tuple(map(int, shape))
        matrix = csr_array((weights, pixels, starts), shape=(prod(rays), height * width))
        return cls(rays, (height, width), matrix)

    def digest(self) -> str:
        """Fingerprint of shapes and weights."""
        return fingerprint(self.arrays())


def normalised(matrix: csr_array[Any]) -> csr_array[Any]:
    """Scale each row of weights to a sum of 1, float32; empty rows stay empty."""
    weights = matrix.astype(np.float64)
    weights.eliminate_zeros()
    sums = np.asarray(weights.sum(axis=1))
    weights.data /= np.repeat(sums, np.diff(weights.indptr))
    weights.sort_indices()
    return weights.astype(RADIANCE)


@dataclass(frozen=True, eq=False)
class ResampledSensor(Sensor):
    """A camera whose merged images are resampled to rays; its frames are not."""

    sensor: CameraModel
    resampling: Resampling

    @property
    def exposures(self) -> tuple[float, ...]:
        """Exposure times of a bracket in seconds, ascending."""
        return self.sensor.exposures

    @property
    def frame_dtype(self) -> np.dtype[Any]:
        """Frames are the camera's counts, uint16."""
        return self.sensor.frame_dtype

    @property
    def bayer(self) -> str | None:
        """Colour mosaic of the camera's frames; None without one."""
        return self.sensor.bayer

    @property
    def black_level_counts(self) -> float:
        """Black level of the camera in counts."""
        return self.sensor.black_level_counts

    @property
    def white_level(self) -> float:
        """Full scale of the camera in counts."""
        return self.sensor.white_level

    def frame_shape(self, camera_shape: tuple[int, ...], channels: int) -> tuple[int, ...]:  # noqa: ARG002
        """Shape of one bracket of the camera, which doesn't depend on the rays."""
        return self.sensor.frame_shape(self.resampling.camera_shape, channels)

    def expose(self, radiance: NDArray[Any], seed: int, key: tuple[int, ...]) -> NDArray[Any]:  # noqa: ARG002
        """Raise InputError, since rays can't be converted to camera pixels."""
        raise InputError(
            f"{picture_name(key)}: a resampled sensor of {self.resampling.shape} rays can't "
            f"simulate frames of radiance of shape {np.shape(radiance)}",
            remedy="take frames with the camera, or use its CameraModel",
        )

    def bracket_merge(self, black: NDArray[Any], black_count: int = 1) -> BracketMerge:
        """Prepare a merge of brackets (B, E, Hc, Wc[, C]) to radiance of rays (B, *rays, C).

        Photosites are merged as grey pixels; then one matrix both demosaics and resamples, so that
        noise which demosaicing spreads over neighbours is counted once. Neighbouring rays with a
        common pixel have correlated noise; the variance is for single rays.
        """
        has_mosaic = self.sensor.bayer is not None
        black = np.asarray(black)
        grey = replace(self.sensor, bayer=None)
        merge = grey.bracket_merge(black[..., None] if has_mosaic else black, black_count)

        def resampled(frames: NDArray[Any], first_index: int = 0) -> MergedImages:
            frames = np.asarray(frames)
            merged = merge(frames[..., None] if has_mosaic else frames, first_index)
            repeats = 1 if has_mosaic else merged.radiance.shape[-1]
            radiance, variance = (
                weighed(matrices * repeats, images.reshape(len(images), -1, images.shape[-1]))
                for matrices, images in (
                    (self.matrices, merged.radiance),
                    (self.squares, merged.variance),
                )
            )
            shape = (len(frames), *self.resampling.shape, -1)
            return MergedImages(radiance.reshape(shape), variance.reshape(shape), merged.saturated)

        return resampled

    def without(self, pixels: NDArray[np.bool_]) -> ResampledSensor:
        """Exclude defective camera pixels; see `Resampling.without`."""
        return replace(self, resampling=self.resampling.without(pixels))

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return {
            "kind": "resampled",
            "sensor": self.sensor.describe(),
            "shape": list(self.resampling.shape),
            "resampling": self.resampling.digest(),
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that `sensor_from_description` needs together with the description."""
        return self.resampling.arrays()

    @cached_property
    def matrices(self) -> list[csr_array[Any]]:
        """Matrices from photosites to rays: one per channel of a mosaic, or one for all."""
        matrix = self.resampling.matrix
        if self.sensor.bayer is None:
            return [matrix]
        shape = self.resampling.camera_shape
        return [matrix @ colour for colour in filling(shape, self.sensor.bayer)]

    @cached_property
    def squares(self) -> list[csr_array[Any]]:
        """Matrices with squared weights, for the variance."""
        return [matrix.power(2) for matrix in self.matrices]


def sensor_from_description(
    description: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]] | None = None
) -> Sensor:
    """Restore a sensor from its description, and from its `arrays` if it is resampled.

    Raises
    ------
    InputError
        When the kind of sensor is unknown, or the arrays belong to another sensor.
    """
    kind = description.get("kind")
    if kind == "exact":
        return ExactSensor()
    if kind == "camera":
        settings = {name: value for name, value in description.items() if name != "kind"}
        return CameraModel(**{**settings, "exposures": tuple(settings["exposures"])})
    if kind != "resampled":
        raise InputError(f"sensor kind {kind!r} is unknown; expected exact, camera or resampled")
    camera = sensor_from_description(description["sensor"])
    resampling = Resampling.from_arrays(arrays or {})
    if not isinstance(camera, CameraModel) or resampling.digest() != description["resampling"]:
        raise InputError(
            f"the arrays of the resampling to {resampling.shape} rays have the digest "
            f"{resampling.digest()}; the sensor's description has {description['resampling']}. "
            "They belong to different calibrations: use the arrays of the same one"
        )
    return ResampledSensor(camera, resampling)
