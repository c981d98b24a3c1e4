"""Light fields: pictures from every view in the light of every view [thesis Fig. 5.8]."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.blocks import Block, Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import Drawing, new_figure
from rfpipe.report.inputs import Inputs
from rfpipe.report.light import Light
from rfpipe.report.text import percent, size
from rfpipe.stages.evaluating.metrics import relative_rms

__all__ = ["SHARED", "draw_views", "light_fields_section", "view_errors"]

_GRID = 3.9  # inches that an array of pictures is wide
_ARRAYS = 3  # relit, true, and their difference
_GAP = 0.12  # between two arrays, of a picture's width
_BRIGHT = 99.5  # percentile of the true pictures' radiance that is shown as white
SHARED = (
    "each picture where its view is in the array; on the left relit, with its relative RMS error, "
    "in the middle ground truth, on the right relit minus true. The framed picture is seen and lit "
    "from the same place."
)
"""What there is to say of every array of pictures."""

_SAME = "#e0914a"  # frame of the picture whose view is also the light


def light_fields_section(inputs: Inputs) -> Section | None:
    """Fig. 5.8, and the errors between views."""
    runs = inputs.light_fields
    if not runs:
        return None
    text = (
        "A stack of views, each a projector and a camera on one axis, placed in a plane and aimed "
        "at the scene: the transport between all their rays is the scene's 8D reflectance field. "
        "The rows of one view and the columns of another render the scene from the one in the "
        "light of the other."
    )
    blocks: list[Block] = []
    for run in runs:
        views = size(*run.settings.view_grid)
        of = f"{run.title}, {run.method_title.lower()}"
        shared = f"{of}: {views} views, {SHARED}"
        stored = run.read("views_relit"), run.read("views_truth")
        for letter, name, what in (
            ("a", "light moves", "The middle view, in the light of each view's projector in turn."),
            ("b", "view moves", "The light of the middle view's projector, seen from each view."),
        ):
            relit, truth = (
                images[:, run.middle_view] if letter == "a" else images[run.middle_view]
                for images in stored
            )
            drawing = draw_views(run.title, run.settings.view_grid, relit, truth)
            slug = f"fig_5_8_{letter}_{run.scene}_{run.method}"
            title, told = f"Fig. 5.8 ({letter}), the {name}", f"{what} {shared}"
            blocks.append(
                Illustration(title, told, slug, drawing, "Fig. 5.8", sources=[run.source])
            )
    caption = (
        "Relative RMS error of the pictures in the light of one view's projector: of the picture "
        "from the same view, and of the other views' pictures, in the mean and at worst."
    )
    blocks.append(Tabulation("Errors between views", caption, view_errors(inputs)))
    sources = [run.source for run in runs]
    return Section("light_fields", "8D reflectance fields (Fig. 5.8)", blocks, [text], sources)


def draw_views(of: str, grid: tuple[int, int], relit: NDArray[Any], truth: NDArray[Any]) -> Drawing:
    """Draw an array of pictures as relit, beside the true ones and the errors.

    Parameters
    ----------
    of : str
        The scene.
    grid : (int, int)
        Rows and columns of the array.
    relit, truth : ndarray of float, shape (V, H, W, C)
        One picture a place; that in the middle is seen and lit from there, and framed.
    """
    rows, columns = grid
    middle = rows // 2 * columns + columns // 2
    white = float(np.percentile(truth, _BRIGHT)) or 1.0
    height, width = truth.shape[1:3]
    panel = _GRID / columns
    size = (_ARRAYS * _GRID + 2 * _GAP * panel, rows * (panel * height / width + 0.2) + 0.25)
    widths = ([1.0] * columns + [_GAP]) * _ARRAYS
    drawing = Drawing(*new_figure(rows, len(widths) - 1, size, width_ratios=widths[:-1]))
    titles = ("relit", "ground truth", "error")
    firsts = {title: index * (columns + 1) for index, title in enumerate(titles)}
    for index, (image, true) in enumerate(zip(relit, truth, strict=True)):
        row, column = divmod(index, columns)
        place = f"row {row + 1}, column {column + 1}"
        pictures = [
            Light(of, f"{what}, {place}", radiance, white)
            for what, radiance in (("relit", image), ("ground truth", true))
        ]
        ours, beside, error = (drawing.axes[row, first + column] for first in firsts.values())
        drawing.show(ours, pictures[0], f"error {relative_rms(image, true):.1%}")
        drawing.show(beside, pictures[1])
        drawing.compare(error, *pictures)
        if index == middle:
            for axis in (ours, beside, error):
                axis.spines[:].set(color=_SAME, linewidth=2.5)
    for gap in drawing.axes[:, columns :: columns + 1].flat:
        gap.set_axis_off()
    for title, first in firsts.items():
        drawing.axes[0, first + columns // 2].set_title(title, fontsize=9.5, pad=5)
    drawing.show_errors()
    return drawing


def view_errors(inputs: Inputs) -> Table:
    """Return the errors of every view's picture in every view's light, of all light fields.

    Returns
    -------
    Table
        A row for each light. Its numbers: ``scene``, ``method``, ``light``, ``view`` (from 0, row
        by row), ``rms``.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    numbers: list[dict[str, Any]] = []
    for run in inputs.light_fields:
        columns = run.settings.view_grid[1]
        of_lights = zip(run.read("views_relit"), run.read("views_truth"), strict=True)
        for light, (relit, truth) in enumerate(of_lights):
            errors = list(map(relative_rms, relit, truth))
            about = {"scene": run.scene, "method": run.method, "light": light}
            numbers += [{**about, "view": view, "rms": rms} for view, rms in enumerate(errors)]
            row, column = divmod(light, columns)
            others = pd.Series(errors).drop(light)
            of_light = {
                "place": f"{row + 1}, {column + 1}",
                "same": errors[light],
                "mean": others.mean(skipna=False),
                "worst": others.max(skipna=False),
            }
            rows.append({**about, **of_light})
    return table_of(
        rows,
        [*inputs.labels, ("light: row, column", "place", str)],
        [
            ("same view", "same", percent),
            ("other views, mean", "mean", percent),
            ("worst", "worst", percent),
        ],
        [("", 3), ("relative RMS error, %", 3)],
        csv="view_errors.csv",
        numbers=pd.DataFrame(numbers),
    )
