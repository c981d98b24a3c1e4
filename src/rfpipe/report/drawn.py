"""The numbers that a drawn figure shows, read back from its axes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.report.entries import Bars, Curve, Panel, Value

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["panels_of", "plain_value"]


def panels_of(figure: Figure) -> list[Panel]:
    """Return the panels of a figure that show anything: titles, labels and the data drawn."""
    return [_panel(axis) for axis in figure.axes if axis.axison]


def plain_value(value: Any) -> Value:
    """Return a number or text as JSON has it: None for NaN and for none, infinity as text."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value if isinstance(value, bool | int | float | str | None) else str(value)


def _panel(axis: Axes) -> Panel:
    texts = [text.get_text() for text in axis.texts]
    return Panel(
        title=axis.get_title(),
        x_label=axis.get_xlabel(),
        y_label=axis.get_ylabel(),
        x_scale=axis.get_xscale(),
        y_scale=axis.get_yscale(),
        texts=[text for text in texts if text],
        curves=[_curve(axis, line) for line in axis.get_lines()],
        bars=[_bars(found) for found in axis.containers if hasattr(found, "patches")],
        areas=[_area(path, found) for found in axis.collections for path in _paths(found)],
        image=_image(axis),
    )


def _values(numbers: Iterable[Any]) -> list[Value]:
    return [plain_value(number) for number in np.asarray(numbers)]


def _label(artist: Any) -> str:
    """Return what a legend calls it; matplotlib's own names begin with an underscore."""
    label = str(artist.get_label())
    return "" if label.startswith("_") else label


def _curve(axis: Axes, line: Any) -> Curve:
    """Return a line's points; none along an axis that it crosses from end to end."""
    along = line.get_transform().contains_branch_seperately(axis.transData)
    x, y = (
        _values(numbers) if is_data else []
        for numbers, is_data in zip(line.get_data(), along, strict=True)
    )
    return Curve(label=_label(line), x=x[:1] if not y else x, y=y[:1] if not x else y)


def _bars(container: Any) -> Bars:
    boxes = [patch.get_bbox() for patch in container.patches]
    return Bars(
        label=_label(container),
        x=_values([box.x0 for box in boxes]),
        y=_values([box.y0 for box in boxes]),
        width=_values([box.width for box in boxes]),
        height=_values([box.height for box in boxes]),
    )


def _paths(collection: Any) -> list[Any]:
    """Return the outlines of a band or of bars of error; a picture of pixels has none."""
    return list(collection.get_paths()) if collection.get_array() is None else []


def _area(path: Any, collection: Any) -> Curve:
    x, y = path.vertices.T
    return Curve(label=_label(collection), x=_values(x), y=_values(y))


def _image(axis: Axes) -> list[Value]:
    """Return the numbers at both ends of a map's colours; none for pictures of light."""
    for image in axis.images:
        if np.asarray(image.get_array()).ndim == 2:
            return _values(image.get_clim())
    return []
