"""The camera model: radiance to counts and back [App. B]."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.demosaic import check_mosaic, mosaic
from rfpipe.photometry.merge import CameraNumbers, CountsMerge
from rfpipe.photometry.sensor import ExactSensor, MergeOptions, Sensor, check_light
from rfpipe.provenance import generator
from rfpipe.units import COUNTS

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig

Float = NDArray[np.float32]
Counts = NDArray[np.uint16]

_EXACT_POISSON_BELOW = 64.0
# Mean electrons below which shot noise is drawn from the Poisson distribution; from there on it
# is a rounded Gaussian of the same mean and variance (skewness of the true one: at most 1/8).


@dataclass(frozen=True)
class CameraModel(CameraNumbers, Sensor):
    """A camera with photon and read noise, limited wells and a converter of few bits.

    Radiance -> lens -> mosaic -> electrons of each exposure (Poisson), full well, read noise
    -> response, gain, black level, rounding -> counts; `merge` is the way back.

    Parameters
    ----------
    exposures : tuple of float
        Exposure times in seconds, ascending, above 0.
    electrons_per_radiance : float
        Electrons a second for a radiance of 1, above 0.
    full_well_electrons : float
        Electrons at which a pixel saturates, above 0; they give full scale.
    read_noise_electrons : float
        Standard deviation in electrons, at least 0.
    dark_current_electrons : float
        Electrons a second without light, at least 0.
    black_level_counts : int
        Counts without electrons, at least 0 and below full scale.
    bits : int
        Bits of the converter, 1 to 16.
    psf_sigma : float
        Standard deviation of the lens blur in pixels, at least 0.
    vignetting : float
        Fraction of the light lost in the corners, in [0, 1).
    flare : float
        Fraction of the light spread evenly over a view, in [0, 1).
    bayer : str or None
        Colour mosaic, one of `BAYER_PATTERNS`, or None for full channels.
    response_gamma : float
        Exponent g of the response, counts above black ~ electrons^(1/g), above 0.
    white_level_counts : int or None
        Full scale of a sensor that saturates below what its bits hold, as raw files say it; above
        the black level. None: ``2**bits - 1``.

    Raises
    ------
    InputError
        When a setting is out of range.
    """

    @property
    def frame_dtype(self) -> np.dtype[Any]:
        """Frames are uint16 counts."""
        return np.dtype(COUNTS)

    def frame_shape(self, camera_shape: tuple[int, ...], channels: int) -> tuple[int, ...]:
        """Shape of one bracket: (E, *camera_shape, C), or (E, *camera_shape) under a mosaic."""
        if self.bayer is None:
            return (len(self.exposures), *camera_shape, channels)
        check_mosaic(camera_shape, channels)
        return (len(self.exposures), *camera_shape)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        settings = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.white_level_counts is None:  # as it was before there was such a setting
            del settings["white_level_counts"]
        return {"kind": "camera", **settings, "exposures": list(self.exposures)}

    def expose(self, radiance: NDArray[Any], seed: int, key: tuple[int, ...]) -> Counts:
        """Take one bracket of a radiance image (*camera_shape, C); see `Sensor.expose`.

        Returns
        -------
        ndarray of uint16
            Shape `frame_shape`, values from 0 to `white_level`.

        Raises
        ------
        CaptureError
            Where the radiance is not finite or is negative.
        InputError
            When the image can't be sampled through the mosaic.
        """
        light = apply_optics(
            check_light(radiance, key), self.psf_sigma, self.vignetting, self.flare
        )
        frames = np.empty(self.frame_shape(light.shape[:-1], light.shape[-1]), COUNTS)
        if self.bayer is not None:
            light = mosaic(light, self.bayer)
        for index, exposure in enumerate(self.exposures):
            frames[index] = self._frame(light, exposure, generator(seed, *key, index))
        return frames

    def merging(self, black: NDArray[Any], options: MergeOptions | None = None) -> CountsMerge:
        """Return what merges many brackets to radiance with its variance.

        Parameters
        ----------
        black : ndarray of float32, shape `frame_shape`
            Mean of the all-off frames in counts. A response_gamma above 1 is steep there: a black
            level that leaves no room for the read noise cuts its lower half off, and the mean of
            bent counts doesn't wholly hold a dark current below the read noise. Darkness is then
            off by a fraction of its noise.
        options : MergeOptions, optional

        Returns
        -------
        CountsMerge
            Merges frames of uint16, shape (B, *frame_shape), in units of radiance; the black
            level's own noise is part of the variance.

        Raises
        ------
        CaptureError
            When `black` has the wrong shape or range.
        """
        return CountsMerge(self, black, options or MergeOptions())

    def _frame(self, light: Float, exposure: float, random: np.random.Generator) -> Counts:
        """Take one exposure of the light on the sensor."""
        mean = light * np.float32(self.electrons_per_radiance * exposure)
        mean += np.float32(self.dark_current_electrons * exposure)
        electrons = random.standard_normal(mean.shape, np.float32)
        electrons *= np.sqrt(mean)
        electrons += mean
        np.rint(electrons, out=electrons)
        few = mean < _EXACT_POISSON_BELOW
        electrons[few] = random.poisson(mean[few])
        np.clip(electrons, 0, self.full_well_electrons, out=electrons)
        if self.read_noise_electrons > 0:
            read = random.standard_normal(mean.shape, np.float32)
            read *= np.float32(self.read_noise_electrons)
            electrons += read
        electrons /= np.float32(self.full_well_electrons)
        if self.response_gamma != 1:
            level = np.abs(electrons.astype(np.float64)) ** (1 / self.response_gamma)
            electrons = np.copysign(level, electrons).astype(np.float32)
        electrons *= self.white_level - self.black_level_counts
        electrons += self.black_level_counts
        np.rint(electrons, out=electrons)
        return np.clip(electrons, 0, self.white_level, out=electrons).astype(COUNTS)


def sensor_from_config(config: CameraConfig | None) -> Sensor:
    """Return the sensor of a run's settings: a camera, or exact radiance for None."""
    if config is None:
        return ExactSensor()
    return CameraModel(**config.model_dump())


def apply_optics(radiance: Float, psf_sigma: float, vignetting: float, flare: float) -> Float:
    """Return the image on the sensor; linear in the radiance, each view and channel by itself.

    Parameters
    ----------
    radiance : ndarray of float32, shape (*camera_shape, C)
        Not negative.
    psf_sigma : float
        Standard deviation of the Gaussian point spread in pixels, 0 for none. The image is
        mirrored at its borders, so that no light is lost there.
    vignetting : float
        Fraction of the light lost in the corners by cos^4 falloff, in [0, 1).
    flare : float
        Fraction of a view's light that is spread evenly over the view, in [0, 1).

    Returns
    -------
    ndarray of float32, shape (*camera_shape, C)
    """
    image = radiance
    if psf_sigma > 0:
        from scipy.ndimage import gaussian_filter

        image = gaussian_filter(image, psf_sigma, axes=(-3, -2), mode="reflect")
    if vignetting > 0:
        image = image * _falloff(image.shape[-3], image.shape[-2], vignetting)
    if flare > 0:
        mean = image.mean(axis=(-3, -2), keepdims=True, dtype=np.float64)
        image = (1 - flare) * image + (flare * mean).astype(np.float32)
    return np.asarray(image, np.float32)


def _falloff(height: int, width: int, vignetting: float) -> Float:
    """Return cos^4 of the field angle, 1 at the centre and ``1 - vignetting`` in the corners."""
    y = np.arange(height) - (height - 1) / 2
    x = np.arange(width) - (width - 1) / 2
    radius_squared = y[:, None] ** 2 + x[None, :] ** 2
    corner = radius_squared[0, 0]
    if corner == 0:  # a single pixel is its own centre
        return np.ones((height, width, 1), np.float32)
    tangent_squared = (1 - vignetting) ** -0.5 - 1
    falloff = (1 + tangent_squared * radius_squared / corner) ** -2.0
    return np.asarray(falloff[..., None], np.float32)
