"""Colour normalization [thesis B.2, Fig. B.1]."""

import numpy as np
import pytest

from rfpipe.photometry.camera import apply_optics
from rfpipe.photometry.demosaic import demosaic, mosaic
from rfpipe.photometry.normalize import LevelGain, apply, level_gain
from rfpipe.units import NormalizationMode

SHAPE = (8, 10, 3)
NONE = np.zeros(SHAPE)


def dimmed(patterns: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Return images with a loss of light and colour, and the floodlit image, their true sum."""
    random = np.random.default_rng(0)
    true = random.uniform(0.1, 1, (patterns, *SHAPE)).astype(np.float32)
    grey = true.mean(axis=-1, keepdims=True)
    images = random.uniform(0.3, 0.9, SHAPE) * (0.5 * true + 0.5 * grey)
    return images.astype(np.float32), true.sum(axis=0)


def gain(
    images: np.ndarray, floodlit: np.ndarray, mode: NormalizationMode, complete: bool = True
) -> LevelGain:
    return level_gain(floodlit, images.sum(axis=0), NONE, mode, complete, 3.0, NONE)


@pytest.mark.parametrize("mode", ["per_channel", "total_energy"])
def test_channels_are_scaled_separately_or_by_the_energy_of_the_image(
    mode: NormalizationMode,
) -> None:
    images, floodlit = dimmed()
    corrected, _ = apply(images, np.ones_like(images), gain(images, floodlit, mode))
    energy = images if mode == "per_channel" else images.sum(axis=-1, keepdims=True)  # E_p
    np.testing.assert_allclose(corrected, energy / energy.sum(axis=0) * floodlit, rtol=1e-5)


@pytest.mark.parametrize(("mode", "complete"), [("none", True), ("total_energy", False)])
def test_normalization_is_skipped_if_disabled_or_if_rays_stay_dark(
    mode: NormalizationMode, complete: bool
) -> None:
    images, floodlit = dimmed()
    variance = np.ones_like(images)
    normalization = gain(images, floodlit, mode, complete)
    assert not normalization.covered.any()
    np.testing.assert_array_equal(normalization.gain, 1)
    corrected, spread = apply(images, variance, normalization)
    assert corrected is images
    assert spread is variance


@pytest.mark.parametrize("mode", ["per_channel", "total_energy"])
@pytest.mark.parametrize("total", [0.0, 1e-30, -0.2, 0.02, 0.3])
def test_pixels_with_a_sum_within_noise_are_not_changed(
    mode: NormalizationMode, total: float
) -> None:
    images, floodlit = dimmed()
    images[:, 2, 3] = total / len(images)
    variance = np.full(SHAPE, 0.0 if total < 0.01 else 0.2**2)
    normalization = level_gain(floodlit, images.sum(axis=0), variance, mode, True, 3.0, NONE)
    assert not normalization.covered[2, 3].any()
    assert np.delete(normalization.covered.reshape(-1, 3), 23, axis=0).any()


@pytest.mark.parametrize("mode", ["per_channel", "total_energy"])
def test_pixels_with_black_or_unknown_floodlit_light_are_not_changed(
    mode: NormalizationMode,
) -> None:
    images, floodlit = dimmed()
    floodlit_variance = np.zeros(SHAPE)
    floodlit[0, 0] = -0.1
    floodlit[0, 1] = 0
    floodlit_variance[0, 2] = 1e6  # saturated in every exposure
    normalization = level_gain(
        floodlit, images.sum(axis=0), NONE, mode, True, 3.0, floodlit_variance
    )
    assert not normalization.covered[0, :3].any()
    assert normalization.covered[1:].all()


def test_a_channel_without_light_stays_dark() -> None:
    images, floodlit = dimmed()
    images[..., 2] = np.random.default_rng(1).normal(0, 1e-3, images.shape[:-1])
    floodlit[..., 2] = np.random.default_rng(2).normal(0, 1e-3, SHAPE[:-1])
    normalization = level_gain(
        floodlit, images.sum(axis=0), np.full(SHAPE, 5e-6), "total_energy", True, 3.0, NONE
    )
    corrected, spread = apply(images, np.full_like(images, 1e-6), normalization)
    np.testing.assert_allclose(corrected.sum(axis=0), np.maximum(floodlit, 0), rtol=1e-4, atol=1e-6)
    assert (spread > 0).all()


@pytest.mark.parametrize("mode", ["per_channel", "total_energy"])
def test_the_variance_follows_the_scaling(mode: NormalizationMode) -> None:
    images, floodlit = dimmed(3)
    sigma = 0.01
    noise = np.random.default_rng(0).normal(0, sigma, (4000, *images.shape[1:])).astype(np.float32)
    normalization = gain(images, floodlit, mode)
    corrected, spread = apply(images[:1] + noise, np.full_like(noise, sigma**2), normalization)
    np.testing.assert_allclose(corrected.var(axis=0), spread[0], rtol=0.15)
    assert corrected.dtype == spread.dtype == np.float32


BLUR = 0.6
"""Standard deviation in pixels: a focused projector beam covers very few photosites."""


def spots() -> np.ndarray:
    """Return radiance on the sensor of a coloured surface lit pixel by pixel."""
    blend = np.linspace(0, 1, 16)[:, None]
    albedo = (1 - blend) * [0.8, 0.25, 0.1] + blend * [0.1, 0.25, 0.8]
    images = np.zeros((12 * 16, 12, 16, 3), np.float32)
    for image, (y, x) in zip(images, np.ndindex(12, 16), strict=True):
        image[y, x] = albedo[x]
        image[...] = apply_optics(image, BLUR, 0, 0)
    return images


def test_normalization_restores_the_colours_of_fig_b_1() -> None:
    """The sum is correct without normalization; the colours of single images are not."""
    light = spots()
    images, _ = demosaic(mosaic(light, "RGGB"), np.ones(light.shape[:-1], np.float32), "RGGB")
    total = images.sum(axis=0)
    floodlit, _ = demosaic(mosaic(light.sum(axis=0), "RGGB"), np.ones(total.shape[:2]), "RGGB")
    np.testing.assert_allclose(total, floodlit, rtol=1e-5)
    exact = np.zeros(total.shape)
    normalization = level_gain(floodlit, total, exact, "total_energy", True, 3.0, exact)
    corrected, _ = apply(images, np.ones_like(images), normalization)
    assert colour_error(corrected, light) < 0.2 * colour_error(images, light)


def colour_error(images: np.ndarray, light: np.ndarray) -> float:
    """Mean error of the channels' shares at each image's lit pixel."""
    lit = np.arange(len(images)), *np.unravel_index(np.arange(len(images)), images.shape[1:3])
    share, true = (values[lit] / values[lit].sum(-1, keepdims=True) for values in (images, light))
    return float(np.abs(share - true).mean())
