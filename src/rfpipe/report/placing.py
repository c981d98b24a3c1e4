"""Placing blocks: their files beside the page, and what the page and ``results.json`` say."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.report.blocks import Block, Gallery, Illustration, Picture, Section, Tabulation
from rfpipe.report.drawing import Drawing, image_png, png
from rfpipe.report.drawn import panels_of, plain_value
from rfpipe.report.entries import (
    Exposure,
    FigureEntry,
    Panel,
    SectionEntry,
    Source,
    TableEntry,
)
from rfpipe.report.light import (
    ERROR_COLOURS,
    Light,
    error_map,
    exposure_text,
    round_limit,
    write_exr,
)
from rfpipe.stages.evaluating.evaluate import write_table
from rfpipe.store.files import digest_of, write_atomically

__all__ = ["Place", "PlacedSection", "source_of"]

_PANEL_PIXELS = 210  # that a picture's panel is wide at least, in its file
_GAPS_A_PANEL = 25
_PNG_SIZE = (16, 20)  # where a PNG file has its width and height
_ERROR = "error"  # what stands above a map of it


@dataclass(frozen=True)
class PlacedSection:
    """A section whose files are written: its entry, and what the page's template needs."""

    entry: SectionEntry
    blocks: list[dict[str, Any]]


def source_of(file: str, root: Path) -> Source:
    """Describe a file that something was made from, by its path from `root`."""
    return Source(file=file, digest=digest_of((root / file).read_bytes()))


@dataclass(frozen=True)
class Place:
    """Where a page's pictures and tables go.

    Attributes
    ----------
    folder : Path
        The page's; ``figures/`` and ``tables/`` come to lie in it.
    root : Path
        The folder that sources are found in.
    """

    folder: Path
    root: Path

    def put(self, section: Section) -> PlacedSection:
        """Write a section's pictures and tables."""
        blocks = [self._block(block, section.sources) for block in section.blocks]
        parts = [part for block in blocks for part in block.get("pictures", [block])]
        entry = SectionEntry(
            anchor=section.anchor,
            title=section.title,
            text=list(section.text),
            content=[part["entry"] for part in parts],
        )
        return PlacedSection(entry, blocks)

    def _block(self, block: Block, sources: Sequence[str]) -> dict[str, Any]:
        if isinstance(block, Gallery):
            return {"pictures": [self._picture(it, it.sources or sources) for it in block.pictures]}
        if isinstance(block, Tabulation):
            return self._table(block, block.sources or sources)
        return self._illustration(block, block.sources or sources)

    def _table(self, block: Tabulation, sources: Sequence[str]) -> dict[str, Any]:
        table = block.table
        file = f"tables/{table.csv}" if table.csv else None
        if table.numbers is not None and file and not table.is_written:
            write_table(self.folder / file, table.numbers)
        records = [] if table.numbers is None else table.numbers.to_dict("records")
        entry = TableEntry(
            name=block.name,
            caption=block.caption,
            groups=list(table.groups),
            columns=table.columns,
            rows=table.rows,
            records=[
                {str(name): plain_value(value) for name, value in record.items()}
                for record in records
            ],
            csv=file,
            sources=self._sources(sources),
        )
        return {"entry": entry, "table": table, "is_folded": block.is_folded}

    def _illustration(self, block: Illustration, sources: Sequence[str]) -> dict[str, Any]:
        """Write a figure's files."""
        drawn = block.figure
        figure, light = (drawn.figure, drawn.light) if isinstance(drawn, Drawing) else (drawn, [])
        alt = block.alt or f"{block.name}: see the caption."
        image = png(figure)
        about = {"name": block.name, "alt": alt}
        caption = _joined(block.caption, exposure_text(light))
        placed = self._figure(
            block.slug, image, light, panels_of(figure), sources, caption=caption, **about
        )
        return {**placed, "is_folded": block.is_folded}

    def _picture(self, picture: Picture, sources: Sequence[str]) -> dict[str, Any]:
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
        alt = f"{picture.name}: {', '.join(panels)}, from left to right."
        placed = self._figure(
            picture.slug,
            image_png(pixels),
            picture.light,
            [],
            sources,
            name=picture.name,
            alt=alt,
            caption=_joined(picture.caption, said),
        )
        return {**placed, "panels": list(panels), "gap": gap, "has_scale": scale is not None}

    def _figure(
        self,
        slug: str,
        image: bytes,
        light: Sequence[Light],
        panels: list[Panel],
        sources: Sequence[str],
        **about: Any,
    ) -> dict[str, Any]:
        """Write a picture's PNG and, where it shows light, its OpenEXR file."""
        file = f"figures/{slug}.png"
        write_atomically(self.folder / file, image)
        exr = exr_digest = None
        if light:
            exr = f"figures/{slug}.exr"
            write_exr(self.folder / exr, light)
            exr_digest = digest_of((self.folder / exr).read_bytes())
        width, height = (int.from_bytes(image[at : at + 4]) for at in _PNG_SIZE)
        entry = FigureEntry(
            **about,
            png=file,
            png_digest=digest_of(image),
            exr=exr,
            exr_digest=exr_digest,
            width=width,
            height=height,
            exposures=[_exposure(it) for it in {it.name: it for it in light}.values()],
            panels=panels,
            sources=self._sources(sources),
        )
        return {"entry": entry, "image": b64encode(image).decode()}

    def _sources(self, files: Sequence[str]) -> list[Source]:
        return [source_of(file, self.root) for file in dict.fromkeys(files)]


def _exposure(light: Light) -> Exposure:
    return Exposure(
        picture=light.name,
        quantity=light.quantity,
        white=light.white,
        brightened=float(np.max(light.gain)),
    )


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
