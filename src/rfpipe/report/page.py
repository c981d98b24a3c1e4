"""Building the report: one page that opens from disk, its pictures and tables beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from rfpipe.config import Config
from rfpipe.errors import StoreError
from rfpipe.report import (
    errors as errors_,
)
from rfpipe.report import (
    estimates,
    glance,
    leaves,
    methods,
    pictures,
    setup,
    times,
    verdicts,
    verification,
)
from rfpipe.report.blocks import Section
from rfpipe.report.inputs import Inputs, load_inputs
from rfpipe.report.origin import RESULTS_NAME, provenance_of
from rfpipe.report.placing import place
from rfpipe.report.text import ray_size
from rfpipe.stages.folder import FILES, write_files
from rfpipe.store.files import write_atomically


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
        The page to write; pictures embedded. ``figures/*.png`` and ``*.exr``, ``tables/*.csv``
        and ``results.json`` come to lie beside it.
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
    title, lead = config.title, _lead(inputs)
    swatches = methods.swatches(inputs.methods) | verdicts.STANDING_COLOURS
    shown = make_sections(inputs)
    write_page(page, title, lead, shown, swatches, _SOURCE, _views(inputs, page))
    summary = {"title": title, "lead": lead, "provenance": provenance_of(inputs)}
    write_atomically(page.with_name(RESULTS_NAME), json.dumps(summary, indent=2).encode())
    suffixes = (".csv", ".exr", ".html", ".json", ".png")
    files = (path for path in sorted(page.parent.rglob("*")) if path.suffix in suffixes)
    write_files(page.with_name(FILES), (path for path in files if path.name != FILES))


def write_page(
    page: Path,
    title: str,
    lead: str,
    sections: Sequence[Section],
    swatches: Mapping[str, str] | None = None,
    source: str = "",
    views: Mapping[str, Sequence[tuple[str, str]]] | None = None,
) -> None:
    """Write a page that opens from disk, its pictures embedded.

    Parameters
    ----------
    page : Path
        ``figures/*.png`` and ``*.exr``, and ``tables/*.csv`` come to lie beside it.
    title, lead : str
        Its heading, and a sentence on what it is about.
    sections : sequence of Section
    swatches : mapping of str to str, optional
        Colours that stand before these texts in tables.
    source : str
        What stands at the page's end.
    views : mapping of str to sequence of (str, str), optional
        Pages to light a scene on, by the scene: method, and the page's path from this one.
    """
    text = _render(
        title=title,
        lead=lead,
        sections=[place(page.parent, section) for section in sections],
        swatches=swatches or {},
        source=source,
        views=views or {},
    )
    write_atomically(page, text.encode())


def make_sections(inputs: Inputs) -> list[Section]:
    """Return the sections that there is something to show in."""
    if inputs.has_truth:
        shown = [
            pictures.methods_section(inputs),
            errors_.errors_section(inputs),
            pictures.matrices_section(inputs),
            pictures.levels_section(inputs),
        ]
    else:
        shown = [pictures.captured_section(inputs)]
    candidates = [
        glance.glance_section(inputs),
        verification.verification_section(inputs),
        errors_.speed_section(inputs),
        *shown,
        verdicts.verdicts_section(inputs),
        estimates.estimates_section(inputs),
        leaves.leaves_section(inputs),
        times.times_section(inputs),
        setup.setup_section(inputs),
    ]
    return [section for section in candidates if section is not None and section.blocks]


def _views(inputs: Inputs, page: Path) -> dict[str, list[tuple[str, str]]]:
    """Return the viewer's pages that lie in the folder ``view`` beside the page."""
    found: dict[str, list[tuple[str, str]]] = {}
    for run in inputs.runs:
        path = f"view/{run.scene}_{run.method}.html"
        if (page.parent / path).is_file():
            found.setdefault(run.title, []).append((run.method_title, path))
    return found


def _lead(inputs: Inputs) -> str:
    """Say in a sentence what the report is about."""
    settings = [inputs.config.scenes[scene] for scene in inputs.scenes]
    sizes = list(dict.fromkeys(ray_size(scene) for scene in settings))
    camera = inputs.config.camera
    if inputs.config.capture.rig == "remote":
        taken = "by a rig behind an acquisition server"
    elif inputs.config.capture.rig == "offline":
        taken = "from pictures that were taken elsewhere and imported"
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
