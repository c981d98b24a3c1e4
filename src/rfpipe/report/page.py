"""Building the report: one page that opens from disk, its pictures and tables beside it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from rfpipe.config import Config
from rfpipe.errors import StoreError
from rfpipe.report import (
    background,
    benchmarks,
    captured,
    estimates,
    light_fields,
    sections,
    speed_error,
)
from rfpipe.report.blocks import Illustration, Section, Tabulation
from rfpipe.report.drawing import png
from rfpipe.report.inputs import METHOD_TITLES, Inputs, load_inputs
from rfpipe.report.text import ray_size
from rfpipe.store.files import write_atomically

__all__ = ["build_report", "make_sections", "write_page"]


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
    write_page(page, config.report.title, _lead(inputs), make_sections(inputs))


def write_page(page: Path, title: str, lead: str, sections: Sequence[Section]) -> None:
    """Write a page that opens from disk, its pictures embedded.

    Parameters
    ----------
    page : Path
        ``figures/*.png`` and ``tables/*.csv`` come to lie beside it.
    title, lead : str
        Its heading, and a sentence on what it is about.
    sections : sequence of Section
    """
    shown = [_placed(section, page.parent) for section in sections]
    write_atomically(page, _render(title, lead, shown).encode())


def make_sections(inputs: Inputs) -> list[Section]:
    """Return the sections that there is something to show in."""
    if inputs.has_truth:
        pictures = [
            sections.summary_section(inputs),
            sections.matrices_section(inputs),
            light_fields.light_fields_section(inputs),
            sections.cost_section(inputs),
            sections.methods_section(inputs),
            sections.levels_section(inputs),
        ]
    else:
        pictures = [captured.captured_section(inputs), sections.cost_section(inputs)]
    candidates = [
        *pictures,
        estimates.estimates_section(inputs),
        sections.leaves_section(inputs),
        sections.speed_section(inputs),
        background.resolution_section(inputs),
        background.mosaic_section(inputs),
        background.stability_section(inputs),
        background.times_section(inputs),
        benchmarks.benchmarks_section(inputs),
        speed_error.rivals_section(inputs),
        background.setup_section(inputs),
    ]
    return [section for section in candidates if section is not None and section.blocks]


def _placed(section: Section, folder: Path) -> dict[str, Any]:
    """Write a section's pictures and tables; return what the page's template needs of it."""
    blocks = []
    for block in section.blocks:
        if isinstance(block, Illustration):
            blocks.append(_placed_figure(block, folder))
        else:
            blocks.append(_placed_table(block, folder))
    return {
        "anchor": section.anchor,
        "title": section.title,
        "text": section.text,
        "blocks": blocks,
    }


def _placed_figure(block: Illustration, folder: Path) -> dict[str, Any]:
    image = png(block.figure)
    file = f"figures/{block.slug}.png"
    write_atomically(folder / file, image)
    return {
        "name": block.name,
        "caption": block.caption,
        "image": b64encode(image).decode(),
        "file": file,
    }


def _placed_table(block: Tabulation, folder: Path) -> dict[str, Any]:
    file = f"tables/{block.table.csv}" if block.table.csv else ""
    if block.numbers is not None and file:
        text = block.numbers.to_csv(index=False, float_format="%.6g", lineterminator="\n")
        write_atomically(folder / file, text.encode())
    return {"name": block.name, "caption": block.caption, "table": block.table, "file": file}


def _lead(inputs: Inputs) -> str:
    """Say in a sentence what the report is about."""
    scenes = list(inputs.config.scenes.values())
    sizes = list(dict.fromkeys(ray_size(scene) for scene in scenes))
    methods = [METHOD_TITLES[method].lower() for method in inputs.methods]
    camera = inputs.config.camera
    if inputs.config.capture.rig == "remote":
        taken = "by a rig behind an acquisition server"
    elif camera is None:
        taken = "from exact radiance"
    else:
        taken = f"through a simulated {camera.bits}-bit camera with noise"
    compared = ", and compared with ground truth" if inputs.has_truth else ""
    count = "one scene" if len(scenes) == 1 else f"{len(scenes)} scenes"
    return (
        f"The light transport between a projector and a coaxial camera, {count} of "
        f"{' and '.join(sizes)} rays, acquired {taken} with {' and '.join(methods)}"
        f"{compared}. Figures and tables are numbered as in the thesis that they follow: "
        "G. Garg, Efficiently Acquiring Reflectance Fields Using Patterned Illumination, PhD "
        "thesis, Stanford University, 2006."
    )


def _render(title: str, lead: str, shown: Sequence[dict[str, Any]]) -> str:
    from jinja2 import Environment, StrictUndefined

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    source = files("rfpipe.report").joinpath("page.html.j2").read_text(encoding="utf-8")
    return environment.from_string(source).render(title=title, lead=lead, sections=shown)
