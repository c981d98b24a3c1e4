"""Fig. B.1: colour normalization of single-pixel images under a Bayer mosaic."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from figures.common import Items, Picture, Size, Table, error, percent
from rfpipe import CameraModel
from rfpipe.array_types import Float
from rfpipe.photometry import MergedImages
from rfpipe.photometry.demosaic import demosaic, mosaic
from rfpipe.photometry.normalize import apply, level_gain
from rfpipe.report.drawing import Panel, draw
from rfpipe.scenes import GEOMETRIES, RadiosityScene, surface_points

_SHAPE = (24, 28)
_BAYER = "RGGB"
_MEDIAN_PIXELS = 5
_BLACK_FRAMES = 8
_SIGNIFICANCE = 3.0  # standard deviations of the noise, as acquisitions have it by default
_MODES = {
    "none": "sum of all images",
    "per_channel": "normalized per channel",
    "total_energy": "normalized by total energy",
}
# Albedo of the bars: red, yellow, green, cyan, blue, magenta, grey.
_BARS = (
    (0.8, 0.2, 0.2), (0.8, 0.7, 0.2), (0.2, 0.7, 0.2), (0.2, 0.6, 0.7),
    (0.2, 0.25, 0.8), (0.7, 0.25, 0.7), (0.75, 0.75, 0.75),
)  # fmt: skip


def items(_size: Size) -> Items:
    """Light colour bars on two planes one pixel at a time, and sum up the images.

    Two ways to a picture: the whole bracket and a linear interpolation of the mosaic, and one as
    cameras had it: the shortest exposure alone, medians of colour differences [Freeman 1988],
    light within noise dropped.
    """
    height, width = _SHAPE
    bars = np.array(_BARS, np.float32)[np.arange(width) * len(_BARS) // width]
    albedo = np.broadcast_to(bars, (height, width, 3))
    scene = RadiosityScene(surface_points(_SHAPE, GEOMETRIES["wedge"]), albedo)
    rays = height * width
    patterns = np.concatenate([np.ones((1, rays)), np.eye(rays)]).astype(np.float32)
    truth = scene.apply(patterns).reshape(-1, *_SHAPE, 3)
    camera = CameraModel()
    rows: list[dict[str, Any]] = []
    panels = []
    for chain, sensor in (
        ("whole bracket, linear", camera),
        ("short exposure, median", replace(camera, exposures=camera.exposures[:1])),
    ):
        chain_panels, chain_rows = _normalized(chain, truth, sensor)
        panels.append(chain_panels)
        rows += chain_rows
    bare = [row for row in rows if row["normalization"] == "none"]
    summary = "; ".join(
        f"{row['chain']}: {percent(row['energy'])} of the light and "
        f"{percent(row['colour_contrast'])} of the colour contrast before it"
        for row in bare
    )
    worst = percent(max(row["rms"] for row in rows if row not in bare))
    caption = f"{summary}; normalized within {worst} of the floodlit image."
    thesis = (
        "the sum of the images of single pixels is dimmer and paler than the floodlit image; "
        "normalization restores it."
    )
    yield Picture("fig_b_1", "Fig. B.1", thesis, caption, draw(panels, 2.4))
    caption = "Of the sum against the floodlit image; image_error: of the images against the truth."
    yield Table("mosaic", "Colour normalization", caption, pd.DataFrame(rows))


def _normalized(
    chain: str, truth: Float, sensor: CameraModel
) -> tuple[list[Panel], list[dict[str, Any]]]:
    """Capture the images of single pixels and sum them up under each normalization."""
    merged = _through_mosaic(truth, sensor)
    images, variance = demosaic(merged.radiance, merged.variance, _BAYER)
    if "median" in chain:
        images = _smooth_colours(images)
        images = np.where(images > _SIGNIFICANCE * np.sqrt(variance), images, 0)
    floodlit, single, spread = images[0], images[1:], variance[1:]
    bright = float(floodlit.max())
    panels, rows = [Panel(floodlit, "floodlit", chain, bright)], []
    for mode, title in _MODES.items():
        gain = level_gain(
            floodlit, single.sum(0), spread.sum(0), mode, complete=True,
            significance=_SIGNIFICANCE, floodlit_variance=variance[0],
        )  # fmt: skip
        scaled, _ = apply(single, spread, gain)
        total = scaled.sum(axis=0)
        energy = float(total.sum() / floodlit.sum())
        contrast = _contrast(total) / _contrast(floodlit)
        below = f"light {energy:.0%}, colour contrast {contrast:.0%}"
        panels.append(Panel(total, title, below, bright))
        rows.append(
            {"chain": chain, "normalization": mode, "energy": energy,
             "colour_contrast": contrast, "rms": error(total, floodlit),
             "image_error": error(scaled, truth[1:])}
        )  # fmt: skip
    return panels, rows


def _through_mosaic(truth: Float, camera: CameraModel) -> MergedImages:
    """Capture and merge images (P, H, W, 3) behind a mosaic: radiance and variance (P, H, W)."""
    samples = mosaic(truth, _BAYER)[..., None]
    frames = np.stack([camera.expose(image, 1, (1, n)) for n, image in enumerate(samples)])
    dark = np.zeros_like(samples[0])
    off = np.stack([camera.expose(dark, 1, (2, n)) for n in range(_BLACK_FRAMES)])
    merged = camera.merge(frames, off.mean(axis=0, dtype=np.float64).astype(np.float32))
    return MergedImages(merged.radiance[..., 0], merged.variance[..., 0], merged.saturated)


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


def _contrast(image: Float) -> float:
    """Return the colour contrast: the deviation of channels from grey, relative to the light."""
    grey = image.mean(axis=-1, keepdims=True)
    return float(np.linalg.norm(image - grey) / np.linalg.norm(grey))
