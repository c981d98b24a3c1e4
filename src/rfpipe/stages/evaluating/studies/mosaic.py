"""Colour normalization of single-pixel images under a Bayer mosaic [thesis Fig. B.1]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods import Options
from rfpipe.photometry import Merged, sensor_from_config
from rfpipe.photometry.demosaic import demosaic, mosaic
from rfpipe.photometry.normalize import Mode, apply, level_gain
from rfpipe.scenes import GEOMETRIES, RadiosityScene, surface_points
from rfpipe.stages.evaluating.metrics import relative_rms

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig, Config

__all__ = ["mosaic_study"]

Float = NDArray[np.float32]

_SHAPE = (24, 28)
_BAYER = "RGGB"
_MEDIAN_PIXELS = 5
_MODES: tuple[Mode, ...] = ("none", "per_channel", "total_energy")
_BLACK_FRAMES = 8

# Albedo of the bars: red, yellow, green, cyan, blue, magenta, grey.
_BARS = (
    (0.8, 0.2, 0.2), (0.8, 0.7, 0.2), (0.2, 0.7, 0.2), (0.2, 0.6, 0.7),
    (0.2, 0.25, 0.8), (0.7, 0.25, 0.7), (0.75, 0.75, 0.75),
)  # fmt: skip


def mosaic_study(config: Config) -> tuple[list[dict[str, Any]], dict[str, NDArray[Any]]]:
    """Light colour bars one pixel at a time before a mosaic camera, and sum up the images.

    The bars stand on two planes at an angle. Two ways to a picture: this project's (the whole
    bracket, linear interpolation of the mosaic), and one as cameras had it (the shortest exposure
    alone, medians of colour differences [Freeman 1988], light within noise dropped).

    Returns
    -------
    rows : list of dict
        ``chain`` ("linear" or "median") and ``normalization``; of the sum of all images
        ``energy`` and ``colour_contrast`` as fractions of the floodlit image's, and ``rms``,
        its relative difference from it; ``image_error``, the relative error of the single-pixel
        images against the truth.
    arrays : dict of ndarray
        Float32 (H, W, 3): ``floodlit_{chain}``, and ``sum_{chain}_{normalization}``.
    """
    from rfpipe.config import CameraConfig

    scene = RadiosityScene(surface_points(_SHAPE, GEOMETRIES["wedge"]), _colour_bars())
    rays = int(np.prod(_SHAPE))
    patterns = np.concatenate([np.ones((1, rays)), np.eye(rays)]).astype(np.float32)
    truth = scene.apply(patterns).reshape(-1, *_SHAPE, 3)
    settings = (config.camera or CameraConfig()).model_copy(
        update={"bayer": None, "psf_sigma": 0.0, "vignetting": 0.0, "flare": 0.0}
    )
    shortest = settings.model_copy(update={"exposures": settings.exposures[:1]})
    significance = Options().noise_significance
    rows: list[dict[str, Any]] = []
    arrays: dict[str, NDArray[Any]] = {}
    for chain, camera in (("linear", settings), ("median", shortest)):
        merged = _through_mosaic(truth, camera, config.seed)
        images, variance = demosaic(merged.radiance, merged.variance, _BAYER)
        if chain == "median":
            images = _smooth_colours(images)
            images = np.where(images > significance * np.sqrt(variance), images, 0)
        floodlit, single, spread = images[0], images[1:], variance[1:]
        arrays[f"floodlit_{chain}"] = floodlit
        for mode in _MODES:
            gain = level_gain(
                floodlit, single.sum(0), spread.sum(0), mode, complete=True,
                significance=significance,
            )  # fmt: skip
            scaled, _ = apply(single, spread, gain)
            total = scaled.sum(axis=0)
            arrays[f"sum_{chain}_{mode}"] = total
            rows.append(
                {
                    "chain": chain,
                    "normalization": mode,
                    "energy": float(total.sum() / floodlit.sum()),
                    "colour_contrast": _colour_contrast(total) / _colour_contrast(floodlit),
                    "rms": relative_rms(total, floodlit),
                    "image_error": relative_rms(scaled, truth[1:]),
                }
            )
    return rows, arrays


def _through_mosaic(truth: Float, camera: CameraConfig, seed: int) -> Merged:
    """Capture and merge images (P, H, W, 3) behind a mosaic: radiance and variance (P, H, W)."""
    sensor = sensor_from_config(camera)
    samples = mosaic(truth, _BAYER)[..., None]
    frames = np.stack(
        [sensor.expose(image, seed, (1, index)) for index, image in enumerate(samples)]
    )
    dark = np.zeros_like(samples[0])
    off = np.stack([sensor.expose(dark, seed, (2, index)) for index in range(_BLACK_FRAMES)])
    black = off.mean(axis=0, dtype=np.float64).astype(np.float32)
    merged = sensor.merge(frames, black)
    return Merged(merged.radiance[..., 0], merged.variance[..., 0], merged.saturated)


def _colour_bars() -> Float:
    """Return the albedo of vertical bars, (H, W, 3)."""
    height, width = _SHAPE
    of_column = np.arange(width) * len(_BARS) // width
    return np.broadcast_to(np.array(_BARS, np.float32)[of_column], (height, width, 3))


def _smooth_colours(images: Float) -> Float:
    """Replace red and blue by green plus the median of their difference around."""
    from scipy.ndimage import median_filter

    green = images[..., 1]
    window = (1, _MEDIAN_PIXELS, _MEDIAN_PIXELS)
    red, blue = (
        green + median_filter(images[..., channel] - green, size=window, mode="mirror")
        for channel in (0, 2)
    )
    return np.stack([red, green, blue], axis=-1)


def _colour_contrast(image: Float) -> float:
    """Return how far the channels are from grey, relative to the image's light."""
    grey = image.mean(axis=-1, keepdims=True)
    return float(np.linalg.norm(image - grey) / np.linalg.norm(grey))
