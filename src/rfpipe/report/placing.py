"""Placing blocks: their files beside the page, and what the page's template needs of them."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.blocks import Block, Gallery, Illustration, Picture, Section, Tabulation
from rfpipe.report.drawing import Drawing, image_png, png
from rfpipe.report.light import (
    ERROR_COLOURS,
    Light,
    error_map,
    exposure_text,
    round_limit,
    write_exr,
)
from rfpipe.stages.evaluating.evaluate import write_table
from rfpipe.store.files import write_atomically

_PANEL_PIXELS = 210  # that a picture's panel is wide at least, in its file
_GAPS_A_PANEL = 25
_PNG_SIZE = (16, 20)  # where a PNG file has its width and height
_ERROR = "error"  # what stands above a map of it

Placed = dict[str, Any]


def place(folder: Path, section: Section) -> Placed:
    """Write a section's pictures and tables into ``figures/`` and ``tables/`` of a folder."""
    return {
        "anchor": section.anchor,
        "title": section.title,
        "text": section.text,
        "blocks": [_block(folder, block) for block in section.blocks],
    }


def _block(folder: Path, block: Block) -> Placed:
    if isinstance(block, Gallery):
        return {"pictures": [_picture(folder, picture) for picture in block.pictures]}
    if isinstance(block, Tabulation):
        return _table(folder, block)
    return _illustration(folder, block)


def _table(folder: Path, block: Tabulation) -> Placed:
    table = block.table
    file = f"tables/{table.csv}" if table.csv else None
    if table.numbers is not None and file and not table.is_written:
        write_table(folder / file, table.numbers)
    about = {"name": block.name, "caption": block.caption, "csv": file}
    return {**about, "table": table, "is_folded": block.is_folded}


def _illustration(folder: Path, block: Illustration) -> Placed:
    drawn = block.figure
    figure, light = (drawn.figure, drawn.light) if isinstance(drawn, Drawing) else (drawn, [])
    return {
        **_figure(folder, block.slug, png(figure)),
        "name": block.name,
        "caption": _joined(block.caption, exposure_text(light)),
        "alt": block.alt or f"{block.name}: see the caption.",
        "is_folded": block.is_folded,
    }


def _picture(folder: Path, picture: Picture) -> Placed:
    """Write pictures side by side as one, a white gap between any two."""
    panels = {light.what: light.shown for light in picture.light}
    said = exposure_text(picture.light)
    scale = None
    if picture.compared:
        relit, truth = (picture.light[index] for index in picture.compared)
        panels[_ERROR], scale, limit = _error_panel(relit, truth)
        said = _joined(
            said,
            f"Error: {relit.what} minus {truth.what}, by the scale at the right from blue, "
            f"\N{MINUS SIGN}{limit:g}\N{NO-BREAK SPACE}% of white, to red, +{limit:g}"
            "\N{NO-BREAK SPACE}%.",
        )
    pixels, gap = _side_by_side(list(panels.values()), scale)
    return {
        **_figure(folder, picture.slug, image_png(pixels), picture.light),
        "name": picture.name,
        "caption": _joined(picture.caption, said),
        "alt": f"{picture.name}: {', '.join(panels)}, from left to right.",
        "panels": list(panels),
        "gap": gap,
        "has_scale": scale is not None,
    }


def _figure(folder: Path, slug: str, image: bytes, light: Sequence[Light] = ()) -> Placed:
    """Write a figure's PNG and, of pictures of a scene, their linear light."""
    file, exr = f"figures/{slug}.png", f"figures/{slug}.exr" if light else None
    write_atomically(folder / file, image)
    if exr:
        write_exr(folder / exr, light)
    width, height = (int.from_bytes(image[at : at + 4]) for at in _PNG_SIZE)
    shown = {"image": b64encode(image).decode(), "width": width, "height": height}
    return {"png": file, "exr": exr, **shown}


def _joined(*texts: str) -> str:
    return " ".join(text for text in texts if text)


def _error_panel(
    relit: Light, truth: Light
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Return an error map and its scale, from top to bottom, in colours; and its end in %."""
    from matplotlib import colormaps

    values = error_map(relit, truth)
    limit = round_limit([values])
    colours = colormaps[ERROR_COLOURS]
    scale = np.linspace(1, 0, len(values))[:, None]
    return colours(values / limit / 2 + 0.5)[..., :3], colours(scale)[..., :3], 100 * limit


def _side_by_side(
    panels: list[NDArray[np.float64]], scale: NDArray[np.float64] | None
) -> tuple[NDArray[np.float64], float]:
    """Enlarge panels and put them into one image; return it and a gap's share of a panel.

    A scale of colours stands at the right, as wide as a gap and after one.
    """
    height, width, _ = panels[0].shape
    times = max(1, -(-_PANEL_PIXELS // width))
    breadth = max(1, width * times // _GAPS_A_PANEL)
    gap = np.ones((height * times, breadth, 3))
    parts = [gap] * (2 * len(panels) - 1)
    parts[::2] = [panel.repeat(times, 0).repeat(times, 1) for panel in panels]
    if scale is not None:
        parts += [gap, scale.repeat(times, 0).repeat(breadth, 1)]
    return np.concatenate(parts, axis=1), breadth / (width * times)
