"""The report of a run: its sections, its summary, and the manifest of its files."""

from __future__ import annotations

import json
from pathlib import Path

from rfpipe.config import Config
from rfpipe.errors import StoreError
from rfpipe.report import errors as errors_
from rfpipe.report import glance, leaves, setup, verification
from rfpipe.report.inputs import ReportInputs, load_inputs
from rfpipe.report.page import Section, write_page
from rfpipe.report.text import STANDING_COLOURS, ray_size
from rfpipe.storage.results import FILES, write_files
from rfpipe.store.files import write_atomically

_SUFFIXES = (".csv", ".exr", ".html", ".json", ".pdf", ".png", ".tex")


def build_report(
    config: Config, results: Path, page: Path, errors: Path, speed_error: Path, note: str = ""
) -> None:
    """Write the report.

    Parameters
    ----------
    config : Config
    results : Path
        Folder of results, see `rfpipe.report.inputs.load_inputs`.
    page : Path
        Page to write, with embedded pictures. ``figures/*.png``, ``*.pdf`` and ``*.exr``,
        ``tables/*.csv`` and ``*.tex``, and ``results.json`` are written to its folder.
    errors, speed_error : Path
        Tables of the evaluate stage.
    note : str
        Sentence that follows the lead.

    Raises
    ------
    StoreError
        If no acquisition of the configuration is relit.
    """
    inputs = load_inputs(config, results, errors, speed_error)
    if not inputs.runs:
        raise StoreError(
            f"{results}: holds no relit acquisition of the scenes "
            f"{', '.join(config.scenes)}; run the relight stage first"
        )
    lead = " ".join(filter(None, (_lead(inputs), note)))
    colours = {inputs.title(name): inputs.style(name)["color"] for name in inputs.methods}
    swatches = colours | STANDING_COLOURS
    write_page(page, config.title, lead, make_sections(inputs), swatches, _views(inputs, page))
    facts = {"title": config.title, "lead": lead, "provenance": setup.provenance_of(inputs)}
    write_atomically(page.with_name("results.json"), json.dumps(facts, indent=2).encode())
    files = (path for path in sorted(page.parent.rglob("*")) if path.suffix in _SUFFIXES)
    write_files(page.with_name(FILES), (path for path in files if path.name != FILES))


def make_sections(inputs: ReportInputs) -> list[Section]:
    """Return the sections of a report that aren't empty."""
    candidates = [
        glance.glance_section(inputs),
        verification.verification_section(inputs),
        verification.verdicts_section(inputs),
        errors_.speed_section(inputs),
        leaves.leaves_section(inputs),
        setup.setup_section(inputs),
    ]
    return [section for section in candidates if section is not None and section.blocks]


def _views(inputs: ReportInputs, page: Path) -> dict[str, list[tuple[str, str]]]:
    """Return title and path of the viewer's pages of each scene, in the folder ``view``."""
    views: dict[str, list[tuple[str, str]]] = {}
    for run in inputs.runs:
        path = f"view/{run.scene}_{run.method}.html"
        if (page.parent / path).is_file():
            views.setdefault(run.scene, []).append((inputs.title(run.method), path))
    return views


def _lead(inputs: ReportInputs) -> str:
    """Return the first sentence of the page."""
    scenes = [f"{scene}, {ray_size(inputs.config.scenes[scene])} rays" for scene in inputs.scenes]
    return f"The light transport between a projector and a camera: {'; '.join(scenes)}."
