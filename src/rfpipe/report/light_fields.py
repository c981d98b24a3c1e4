"""Light fields: pictures from every view in the light of every view [thesis Fig. 5.8]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.report.blocks import Block, Illustration, Section, Table, Tabulation, table_of
from rfpipe.report.drawing import label_below, new_figure, show_radiance
from rfpipe.report.inputs import Inputs, Run
from rfpipe.report.text import percent, size
from rfpipe.stages.evaluating.metrics import relative_rms

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["light_fields_section", "view_errors", "views_figure"]

_GRID = 5.7  # inches that an array of pictures is wide
_GAP = 0.12  # between two arrays, of a picture's width
_BRIGHT = 99.5  # percentile of the true pictures' radiance that is shown as white
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
        shared = (
            f"{of}: {views} views, each picture where its view is in the array; on the left "
            "relit, with its relative RMS error, on the right ground truth. The framed picture "
            "is seen and lit from the same place. All pictures have one scale."
        )
        for letter, name, what in (
            ("a", "light moves", "The middle view, in the light of each view's projector in turn."),
            ("b", "view moves", "The light of the middle view's projector, seen from each view."),
        ):
            figure = views_figure(run, is_light_moving=letter == "a")
            slug = f"fig_5_8_{letter}_{run.scene}_{run.method}"
            title = f"Fig. 5.8 ({letter}), the {name}"
            blocks.append(Illustration(title, f"{what} {shared}", slug, figure))
    caption = (
        "Relative RMS error of the pictures in the light of one view's projector: of the picture "
        "from the same view, and of the other views' pictures, in the mean and at worst."
    )
    blocks.append(Tabulation("Errors between views", caption, view_errors(inputs)))
    return Section("light_fields", "8D reflectance fields (Fig. 5.8)", blocks, [text])


def views_figure(run: Run, *, is_light_moving: bool) -> Figure:
    """Draw an array of pictures as relit, beside the true ones.

    Parameters
    ----------
    run : Run
        Of a light field.
    is_light_moving : bool
        Whether the light moves before the middle view, or the view in the middle one's light.
    """
    rows, columns = run.settings.view_grid
    middle = run.middle_view
    relit, truth = (
        images[:, middle] if is_light_moving else images[middle]
        for images in (run.read("views_relit"), run.read("views_truth"))
    )
    white = float(np.percentile(truth, _BRIGHT)) or 1.0
    height, width = run.settings.shape
    panel = _GRID / columns
    figure, axes = new_figure(
        rows,
        2 * columns + 1,
        (2 * _GRID + _GAP * panel, rows * (panel * height / width + 0.2) + 0.25),
        width_ratios=[1.0] * columns + [_GAP] + [1.0] * columns,
    )
    for row in axes:
        row[columns].set_axis_off()
    for index in range(rows * columns):
        row, column = divmod(index, columns)
        ours, true = axes[row, column], axes[row, columns + 1 + column]
        show_radiance(ours, relit[index], white)
        show_radiance(true, truth[index], white)
        label_below(ours, f"error {relative_rms(relit[index], truth[index]):.1%}")
        if index == middle:
            for axis in (ours, true):
                axis.spines[:].set(color=_SAME, linewidth=2.5)
    for first, title in ((0, "Relit"), (columns + 1, "Ground truth")):
        axes[0, first + columns // 2].set_title(title, fontsize=9.5, pad=5)
    return figure


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
