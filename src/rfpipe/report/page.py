"""Building the report: one page that opens from disk, its pictures and tables beside it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.config import Config
from rfpipe.errors import StoreError
from rfpipe.report import (
    background,
    benchmarks,
    estimates,
    glance,
    light_fields,
    methods,
    sections,
    single_responses,
    speed_error,
)
from rfpipe.report.blocks import Block, Gallery, Picture, Section, Tabulation
from rfpipe.report.drawing import image_png, png
from rfpipe.report.inputs import Inputs, load_inputs
from rfpipe.report.text import ray_size
from rfpipe.stages.evaluating.evaluate import write_table
from rfpipe.store.files import write_atomically

__all__ = ["build_report", "make_sections", "write_page"]

_PANEL_PIXELS = 210  # that a picture's panel is wide at least, in its file
_GAPS_A_PANEL = 25
_PNG_SIZE = (16, 20)  # where a PNG file has its width and height


def build_report(
    config: Config, results: Path, page: Path, errors: Path, speed_error: Path
) -> None:
    """Write the report.

    Parameters
    ----------
    config : Config
    results : Path
        What the stages left, see `rfpipe.report.inputs.load_inputs`.
    page : Path
        The page to write; pictures embedded. ``figures/*.png`` and ``tables/*.csv`` come to lie
        beside it.
    errors, speed_error : Path
        The tables of the evaluate stage.

    Raises
    ------
    StoreError
        When no acquisition of the configuration has been relit.
    """
    inputs = load_inputs(config, results, errors, speed_error)
    if not inputs.runs:
        raise StoreError(
            f"{results}: holds no relit acquisition of the scenes "
            f"{', '.join(config.scenes)}; run the relight stage first"
        )
    write_page(
        page,
        config.report.title,
        _lead(inputs),
        make_sections(inputs),
        methods.swatches(inputs.methods),
        _SOURCE,
    )


def write_page(
    page: Path,
    title: str,
    lead: str,
    sections: Sequence[Section],
    swatches: Mapping[str, str] | None = None,
    source: str = "",
) -> None:
    """Write a page that opens from disk, its pictures embedded.

    Parameters
    ----------
    page : Path
        ``figures/*.png`` and ``tables/*.csv`` come to lie beside it.
    title, lead : str
        Its heading, and a sentence on what it is about.
    sections : sequence of Section
    swatches : mapping of str to str, optional
        Colours that stand before these texts in tables.
    source : str
        What stands at the page's end.
    """
    shown = [_placed(section, page.parent) for section in sections]
    text = _render(title=title, lead=lead, sections=shown, swatches=swatches or {}, source=source)
    write_atomically(page, text.encode())


def make_sections(inputs: Inputs) -> list[Section]:
    """Return the sections that there is something to show in."""
    if inputs.has_truth:
        pictures = [
            sections.methods_section(inputs),
            single_responses.single_responses_section(inputs),
            sections.errors_section(inputs),
            light_fields.light_fields_section(inputs),
            sections.matrices_section(inputs),
            sections.levels_section(inputs),
        ]
    else:
        pictures = [sections.captured_section(inputs)]
    candidates = [
        glance.glance_section(inputs),
        sections.speed_section(inputs),
        *pictures,
        sections.cost_section(inputs),
        estimates.estimates_section(inputs),
        sections.leaves_section(inputs),
        *background.studies_sections(inputs),
        background.times_section(inputs),
        benchmarks.benchmarks_section(inputs),
        speed_error.rivals_section(inputs),
        background.setup_section(inputs),
    ]
    return [section for section in candidates if section is not None and section.blocks]


def _placed(section: Section, folder: Path) -> dict[str, Any]:
    """Write a section's pictures and tables; return what the page's template needs of it."""
    return {**vars(section), "blocks": [_placed_block(block, folder) for block in section.blocks]}


def _placed_block(block: Block, folder: Path) -> dict[str, Any]:
    if isinstance(block, Gallery):
        return {"pictures": [_placed_picture(picture, folder) for picture in block.pictures]}
    if isinstance(block, Tabulation):
        file = f"tables/{block.table.csv}" if block.table.csv else ""
        if block.table.numbers is not None and file:
            write_table(folder / file, block.table.numbers)
        return {**vars(block), "file": file}
    alt = block.alt or f"{block.name}: see the caption."
    return {**vars(block), "alt": alt, **_placed_image(block.slug, png(block.figure), folder)}


def _placed_picture(picture: Picture, folder: Path) -> dict[str, Any]:
    """Put a picture's panels into one image, a white gap between any two."""
    first = next(iter(picture.panels.values()))
    height, width, _ = first.shape
    scale = max(1, -(-_PANEL_PIXELS // width))
    gap = np.ones((height * scale, max(1, width * scale // _GAPS_A_PANEL), 3))
    parts = [gap] * (2 * len(picture.panels) - 1)
    parts[::2] = [panel.repeat(scale, 0).repeat(scale, 1) for panel in picture.panels.values()]
    return {
        **vars(picture),
        "alt": f"{picture.name}: {', '.join(picture.panels)}, from left to right.",
        "gap": gap.shape[1] / (width * scale),
        **_placed_image(picture.slug, image_png(np.concatenate(parts, axis=1)), folder),
    }


def _placed_image(slug: str, image: bytes, folder: Path) -> dict[str, Any]:
    file = f"figures/{slug}.png"
    write_atomically(folder / file, image)
    width, height = (int.from_bytes(image[at : at + 4]) for at in _PNG_SIZE)
    about = {"file": file, "width": width, "height": height}
    return {**about, "image": b64encode(image).decode()}


def _lead(inputs: Inputs) -> str:
    """Say in a sentence what the report is about."""
    settings = [inputs.config.scenes[scene] for scene in inputs.scenes]
    sizes = list(dict.fromkeys(ray_size(scene) for scene in settings))
    camera = inputs.config.camera
    if inputs.config.capture.rig == "remote":
        taken = "by a rig behind an acquisition server"
    elif camera is None:
        taken = "from exact radiance"
    else:
        taken = f"through a simulated {camera.bits}-bit camera with noise"
    compared = ", and compared with ground truth" if inputs.has_truth else ""
    count = "one scene" if len(settings) == 1 else f"{len(settings)} scenes"
    return (
        f"The light transport between a projector and a camera, {count} of "
        f"{' and '.join(sizes)} rays, acquired {taken} with {methods.listed(inputs.methods)}"
        f"{compared}."
    )


_SOURCE = (
    "Figures and tables are numbered as in the thesis that they follow: G. Garg, Efficiently "
    "Acquiring Reflectance Fields Using Patterned Illumination, PhD thesis, Stanford University, "
    "2006."
)


def _render(**parts: Any) -> str:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    source = files("rfpipe.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(**parts)
