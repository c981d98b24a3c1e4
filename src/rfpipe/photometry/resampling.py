"""From camera pixels to rays: resampling merged images, and the sensor that does so."""

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
from rfpipe.photometry.sensor import BracketMerge, ExactSensor, Merged, Sensor
from rfpipe.provenance import fingerprint
from rfpipe.units import RADIANCE, picture_name

if TYPE_CHECKING:
    from scipy.sparse import csr_array


Float = NDArray[np.float32]

LEAST_LEFT = 0.1
"""A ray whose defective pixels had more than all but this share of its weight has none left."""

_PREFIX = "resampling_"


@dataclass(frozen=True, eq=False)
class Resampling:
    """What share each camera pixel has in each ray.

    A ray that the camera doesn't see has no weights: its radiance is 0 with a variance of 0, which
    is exactly no light. It is never significant, and it stops nothing. For ``T`` to stay symmetric
    it must not be lit, either: a calibrated layout leaves its projector pixels dark.

    Parameters
    ----------
    shape : tuple of int
        The rays, see `RayDomain`.
    camera_shape : tuple of int
        The camera's pixels, (Hc, Wc).
    matrix : csr_array of float32, shape (rays, camera pixels)
        Both in row-major order. Each row sums to 1, or is empty where a ray is not seen. Weights
        may be negative, where neighbouring rays share camera pixels.
    """

    shape: tuple[int, ...]
    camera_shape: tuple[int, int]
    matrix: csr_array[Any]

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Whether the camera sees a ray, shape `shape`."""
        return np.asarray(np.diff(self.matrix.indptr) > 0).reshape(self.shape)

    def without(self, pixels: NDArray[np.bool_]) -> Resampling:
        """Return a resampling that takes nothing from some camera pixels (bool, `camera_shape`).

        Each ray's other pixels take over. A ray that has none left is not seen.
        """
        from scipy.sparse import csr_array, diags_array

        kept = csr_array(self.matrix @ diags_array((~pixels.ravel()).astype(np.float32)))
        kept.eliminate_zeros()
        enough = np.asarray(kept.sum(axis=1)) >= LEAST_LEFT
        kept = csr_array(diags_array(enough.astype(np.float32)) @ kept)
        return replace(self, matrix=normalised(kept))

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what `from_arrays` needs, to be stored."""
        return {
            f"{_PREFIX}shape": np.array(self.shape, np.int32),
            f"{_PREFIX}camera_shape": np.array(self.camera_shape, np.int32),
            f"{_PREFIX}starts": self.matrix.indptr.astype(np.int64),
            f"{_PREFIX}pixels": self.matrix.indices.astype(np.int32),
            f"{_PREFIX}weights": self.matrix.data.astype(np.float32),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Resampling:
        """Return the resampling whose `arrays` these are."""
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
    """Scale the rows of weights to sum to 1; empty rows stay empty. float32."""
    weights = matrix.astype(np.float64)
    weights.eliminate_zeros()
    sums = np.asarray(weights.sum(axis=1))
    weights.data /= np.repeat(sums, np.diff(weights.indptr))
    weights.sort_indices()
    return weights.astype(RADIANCE)


@dataclass(frozen=True, eq=False)
class ResampledSensor(Sensor):
    """A camera whose merged images are resampled to rays; its frames stay those of the camera."""

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

    def frame_shape(self, camera_shape: tuple[int, ...], channels: int) -> tuple[int, ...]:  # noqa: ARG002
        """Shape of one bracket: that of the camera behind the rays, whatever their shape."""
        return self.sensor.frame_shape(self.resampling.camera_shape, channels)

    def expose(self, radiance: NDArray[Any], seed: int, key: tuple[int, ...]) -> NDArray[Any]:  # noqa: ARG002
        """Raise InputError: from rays there is no way back to the camera's pixels."""
        raise InputError(
            f"{picture_name(key)}: a resampled sensor of {self.resampling.shape} rays can't be "
            f"exposed to a picture {np.shape(radiance)}; its frames come from a camera"
        )

    def merging(self, black: NDArray[Any], black_count: int = 1) -> BracketMerge:
        """Return what merges brackets (B, E, Hc, Wc[, C]) of the camera to rays (B, *rays, C).

        Photosites are merged as grey pixels, then one matrix fills in the mosaic and resamples: the
        noise that the filling spreads over neighbours counts once. Neighbouring rays that share a
        pixel share its noise; the variance is each ray's own.
        """
        has_mosaic = self.sensor.bayer is not None
        black = np.asarray(black)
        grey = replace(self.sensor, bayer=None)
        merge = grey.merging(black[..., None] if has_mosaic else black, black_count)

        def resampled(frames: NDArray[Any], first_index: int = 0) -> Merged:
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
            return Merged(radiance.reshape(shape), variance.reshape(shape), merged.saturated)

        return resampled

    def without(self, pixels: NDArray[np.bool_]) -> ResampledSensor:
        """Return a sensor that takes nothing from defective pixels; see `Resampling.without`."""
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
        """Return what `sensor_from_description` needs beside the description."""
        return self.resampling.arrays()

    @cached_property
    def matrices(self) -> list[csr_array[Any]]:
        """From photosites to rays, one for each channel of a mosaic; one for all without."""
        matrix = self.resampling.matrix
        if self.sensor.bayer is None:
            return [matrix]
        return [matrix @ each for each in filling(self.resampling.camera_shape, self.sensor.bayer)]

    @cached_property
    def squares(self) -> list[csr_array[Any]]:
        """The same with squared weights, for the variance."""
        return [matrix.power(2) for matrix in self.matrices]


def sensor_from_description(
    description: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]] | None = None
) -> Sensor:
    """Return the sensor of a description, given a resampled sensor's `arrays`.

    Raises
    ------
    InputError
        When the description is none of a known sensor, or the arrays are of another.
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
            f"the arrays of a resampling to {resampling.shape} rays are not those of the sensor "
            f"described (digest {description['resampling']}): they are of another calibration"
        )
    return ResampledSensor(camera, resampling)
