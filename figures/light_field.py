"""Fig. 5.8 of a light field that a run acquired: ``python -m figures light_field OUT``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from figures.common import Float, Items, Picture, Size, Table, error, percent
from figures.panels import new_figure, srgb
from rfpipe.store import open_arrays

THESIS = (
    "from nine views and in nine lights: shadows move with the light, and parallax with the view."
)
_GRID = 3.9  # inches that an array of pictures is wide
_BRIGHT = 99.5  # percentile of the true pictures' radiance that is shown as white


def items(_size: Size) -> Items:
    """Draw every light field in the run's folder ``results``."""
    for manifest in sorted(Path("results").glob("*/*/relight.json")):
        stored = open_arrays(manifest.with_suffix(".zarr"))
        if "views_relit" in stored.names:
            of = f"{manifest.parent.parent.name}, by {manifest.parent.name}."
            pictures = (stored.read(f"views_{name}") for name in ("relit", "truth"))
            yield from arrays_of_views(*pictures, of, f"_{manifest.parent.parent.name}")


def arrays_of_views(relit: Float, truth: Float, told: str, suffix: str = "") -> Items:
    """Draw what each view (second axis) sees in the light of each view (first axis).

    Parameters
    ----------
    relit, truth : ndarray of float32, shape (V, V, H, W, C)
        Of a square array of views.
    told : str
        What there is to say beside it.
    suffix : str
        Of the files' names.
    """
    middle = len(truth) // 2
    worst = max(
        map(error, relit.reshape(-1, *relit.shape[2:]), truth.reshape(-1, *truth.shape[2:]))
    )
    told = f"Errors of {len(truth) ** 2} pictures: up to {percent(worst)}. {told}"
    for letter, name, pair in (
        ("a", "the light moves, the middle view sees", (relit[:, middle], truth[:, middle])),
        ("b", "the middle view lights, the view moves", (relit[middle], truth[middle])),
    ):
        slug = f"fig_5_8_{letter}{suffix}"
        yield Picture(slug, f"Fig. 5.8 ({letter}), {name}", THESIS, told, _draw(*pair))
    rows = [
        {"light": light, "view": view, "error": error(relit[light, view], truth[light, view])}
        for light, view in np.ndindex(truth.shape[:2])
    ]
    about = "Relative RMS errors, lights and views counted row by row."
    yield Table(f"view_errors{suffix}", "Errors between views", about, pd.DataFrame(rows))


def _draw(relit: Float, truth: Float) -> object:
    """Draw a square array of pictures as relit, beside the true ones and the differences."""
    side = round(len(truth) ** 0.5)
    bright = float(np.percentile(truth, _BRIGHT)) or 1.0
    height, width = truth.shape[1:3]
    tall = side * (_GRID / side * height / width + 0.2) + 0.25
    figure, axes = new_figure(side, 3 * side, (3 * _GRID + 0.5, tall))
    errors = 100 * (np.asarray(relit, float) - truth).mean(axis=-1) / bright
    limit = max(float(np.percentile(np.abs(errors), 99)), 1e-3)
    for index, (image, true) in enumerate(zip(relit, truth, strict=True)):
        row, column = divmod(index, side)
        ours, beside, difference = axes[row, column::side]
        ours.imshow(srgb(image, bright), interpolation="nearest")
        ours.set_xlabel(f"error {percent(error(image, true))}", fontsize=8)
        beside.imshow(srgb(true, bright), interpolation="nearest")
        shown = difference.imshow(errors[index], cmap="RdBu_r", vmin=-limit, vmax=limit)
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
    for title, axis in zip(
        ("relit", "ground truth", "error"), axes[0, side // 2 :: side], strict=True
    ):
        axis.set_title(title, fontsize=9.5)
    figure.colorbar(shown, ax=list(axes[-1, -1:])).set_label(
        "relit - truth, % of white", fontsize=8
    )
    return figure
