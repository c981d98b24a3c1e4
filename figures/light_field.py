"""Fig. 5.8 of a light field that a run acquired: ``python -m figures light_field OUT``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from figures.common import Items, Picture, Size, Table, error, percent
from rfpipe.array_types import Float
from rfpipe.report.drawing import Panel, difference, draw
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
            scene, method = manifest.parts[-3:-1]
            pictures = (stored.read(f"views_{name}") for name in ("relit", "truth"))
            yield from arrays_of_views(*pictures, f"{scene}, by {method}.", f"_{scene}_{method}")


def arrays_of_views(relit: Float, truth: Float, remark: str, suffix: str = "") -> Items:
    """Draw what each view (second axis) sees in the light of each view (first axis).

    Parameters
    ----------
    relit, truth : ndarray of float32, shape (V, V, H, W, C)
        Of a square array of views.
    remark : str
        Text after the errors.
    suffix : str
        Of the files' names.
    """
    middle = len(truth) // 2
    worst = max(
        map(error, relit.reshape(-1, *relit.shape[2:]), truth.reshape(-1, *truth.shape[2:]))
    )
    remark = f"Errors of {len(truth) ** 2} pictures: up to {percent(worst)}. {remark}"
    for letter, name, pair in (
        ("a", "the light moves, the middle view sees", (relit[:, middle], truth[:, middle])),
        ("b", "the middle view lights, the view moves", (relit[middle], truth[middle])),
    ):
        slug = f"fig_5_8_{letter}{suffix}"
        yield Picture(slug, f"Fig. 5.8 ({letter}), {name}", THESIS, remark, _draw(*pair))
    rows = [
        {"light": light, "view": view, "error": error(relit[light, view], truth[light, view])}
        for light, view in np.ndindex(truth.shape[:2])
    ]
    caption = "Relative RMS errors, lights and views counted row by row."
    yield Table(f"view_errors{suffix}", "Errors between views", caption, pd.DataFrame(rows))


def _draw(relit: Float, truth: Float) -> object:
    """Draw a square array of pictures as relit, beside the true ones and the differences."""
    side = round(len(truth) ** 0.5)
    bright = float(np.percentile(truth, _BRIGHT)) or 1.0
    ours, true, errors = [], [], []
    for image, exact in zip(relit, truth, strict=True):
        ours.append(Panel(image, "", f"error {percent(error(image, exact))}", bright))
        true.append(Panel(exact, "truth", "", bright))
        errors.append(difference(image, exact, bright))
    rows = (slice(first, first + side) for first in range(0, len(truth), side))
    return draw([[*ours[row], *true[row], *errors[row]] for row in rows], _GRID / side)
