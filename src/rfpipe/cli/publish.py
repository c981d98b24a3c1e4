"""``rfpipe publish``: a run as a crate that can be cited, checked and relit."""

from __future__ import annotations

import sys
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rfpipe.errors import InputError

if TYPE_CHECKING:
    from rfpipe.publish import Citation, Run

__all__ = ["publish"]


def publish(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="A run's folder, in which its 'results' lie."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Zip file (*.zip) or folder to write; publication.zip in FOLDER by default. Of a "
            "zip, others can relight over the network with few requests.",
        ),
    ] = None,
    license_: Annotated[
        str | None,
        typer.Option("--license", help="Licence, by its name in the SPDX list, such as CC-BY-4.0."),
    ] = None,
    creator: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Who is to be cited: 'Family, Given; ORCID; affiliation'; may be repeated.",
        ),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Title; the report's by default.")] = None,
    description: Annotated[str | None, typer.Option(help="What it is, in a few sentences.")] = None,
    publisher: Annotated[str | None, typer.Option(help="Who keeps it, such as Zenodo.")] = None,
    doi: Annotated[str | None, typer.Option(help="Its DOI, if it has one already.")] = None,
    keyword: Annotated[list[str] | None, typer.Option(help="May be repeated.")] = None,
    version: Annotated[
        str | None, typer.Option(help="Version of the data, 1.0.0 at first.")
    ] = None,
    published: Annotated[
        str | None, typer.Option("--date", help="Of publication, YYYY-MM-DD; at first, today.")
    ] = None,
    captured: Annotated[
        bool,
        typer.Option(
            "--captured", help="Publish the captured frames, too, and all that was made of them."
        ),
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(help="The run's settings, where it has no report, which knows them."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the rig's calibration; 'calibration' in FOLDER by default, for runs "
            "with a real rig."
        ),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a publication that stands there.")
    ] = False,
) -> None:
    """Write a run's transports, report and pictures as a crate that can be cited and checked.

    The crate is a Workflow Run RO-Crate with DataCite and Croissant metadata, SHA-256 of every
    file, and a ten-line example that relights it from a folder, a zip file or an address. Licence
    and creators are asked for once and kept in FOLDER/publication.yaml, which may be edited; the
    options change what is kept there. Without a terminal, give --license and --creator.
    """
    from rfpipe.publish import Creator, citation_values, find_run, parse_citation, write_citation
    from rfpipe.publish import publish as write

    run = find_run(folder)
    given: dict[str, Any] = {
        "title": title,
        "description": description,
        "creators": [Creator.parse(text).model_dump() for text in creator or []] or None,
        "license": license_,
        "publisher": publisher,
        "published": published,
        "version": version,
        "keywords": keyword or None,
        "doi": doi,
    }
    citation = parse_citation(_completed(citation_values(run.folder, given), run))
    write_citation(run.folder, citation)
    place = output or run.folder / "publication.zip"
    made = write(
        run,
        citation,
        place,
        captured=captured,
        config=config,
        calibration=calibration,
        overwrite=overwrite,
    )
    _say(made.path, made.files, made.nbytes, citation)
    if run.settings is None and config is None:
        typer.echo(
            "without its settings, which a run without a report doesn't keep: give them, "
            "--config SETTINGS.yaml, with --overwrite",
            err=True,
        )
    if run.incomplete:
        typer.echo(f"left out, since they aren't complete: {', '.join(run.incomplete)}", err=True)


def _completed(values: dict[str, Any], run: Run) -> dict[str, Any]:
    """Fill in what nobody has said yet; ask for it where that is for a person to say."""
    from rfpipe.publish import CITATION_FILE, Creator

    values.setdefault("title", run.title)
    values.setdefault("description", _description(run))
    values.setdefault("published", date.today().isoformat())
    missing = [name for name in ("creators", "license") if not values.get(name)]
    if missing and not sys.stdin.isatty():
        options = {"creators": "--creator 'Family, Given'", "license": "--license CC-BY-4.0"}
        raise InputError(
            f"{run.folder / CITATION_FILE}: {' and '.join(missing)} aren't known; give "
            f"{' and '.join(options[name] for name in missing)}, once: they are kept"
        )
    if missing:
        typer.echo(f"Asked once, and kept in {run.folder / CITATION_FILE}:")
        values["title"] = typer.prompt("Title", default=values["title"])
    if "creators" in missing:
        names = [typer.prompt("Creator, as 'Family, Given; ORCID; affiliation'")]
        while name := typer.prompt("Another creator (empty for none)", default="").strip():
            names.append(name)
        values["creators"] = [Creator.parse(name).model_dump() for name in names]
    if "license" in missing:
        values["license"] = typer.prompt("Licence (SPDX name)", default="CC-BY-4.0")
    return values


def _description(run: Run) -> str:
    methods = dict.fromkeys(found.method for found in run.acquisitions)
    return (
        f"Light transport between a projector and a camera: {run.scenes}, acquired by "
        f"{', '.join(methods)} with rfpipe, to be relit under any pattern."
    )


def _say(path: Path, files: int, nbytes: int, citation: Citation) -> None:
    typer.echo(f"{path}: {files:,} files, {nbytes / 1e6:,.1f} MB, {citation.license}")
    typer.echo(f"cite as: {citation.text}")
    typer.echo(f"check:   rfpipe verify {path}")
