"""``rfpipe publish``, ``keep`` and ``collection``: results on their way to others."""

from __future__ import annotations

import shlex
import sys
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import typer

from rfpipe.errors import InputError

Folder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="A run's folder, in which its 'results' lie.")
]

_QUESTIONS = {
    "creators": "Creator, as 'Family, Given; ORCID; affiliation'",
    "license": "Licence, by its name in the SPDX list, such as CC-BY-4.0",
}


def publish(
    folder: Folder,
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
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a publication that stands there.")
    ] = False,
) -> None:
    """Write a run's transports, report and pictures as a crate that can be cited and checked.

    The crate is a Workflow Run RO-Crate with DataCite metadata, SHA-256 of every
    file, and a ten-line example that relights it from a folder, a zip file or an address. Licence
    and creators are asked for once and kept in FOLDER/publication.yaml, with a title, a version
    and more to edit. Without a terminal, give --license and --creator.
    """
    from rfpipe.output import checked_output
    from rfpipe.publishing.metadata import CITATION_FILE, stored_values, write_citation
    from rfpipe.publishing.publication import publish as write
    from rfpipe.publishing.run import find_run

    if output is not None:
        checked_output("publish", output)
    run = find_run(folder)
    facts = {"title": run.title, "published": date.today()}
    values: dict[str, Any] = facts | stored_values(run.folder)
    values |= {"license": license_} if license_ else {}
    values |= {"creators": creator} if creator else {}
    for name, question in _QUESTIONS.items():
        if not values.get(name) and sys.stdin.isatty():
            answer = typer.prompt(f"{question} (kept in {run.folder / CITATION_FILE})")
            values[name] = [answer] if name == "creators" else answer
    citation = write_citation(run.folder, values)
    place = output or run.folder / "publication.zip"
    written = write(
        run,
        citation,
        place,
        captured=captured,
        config=config,
        overwrite=overwrite,
    )
    megabytes = f"{written.nbytes / 1e6:,.1f} MB"
    typer.echo(f"{place}: {written.files:,} files, {megabytes}, {citation.license}")
    typer.echo(f"cite as: {citation.text}")
    typer.echo(f"check:   {shlex.join(['rfpipe', 'verify', str(place)])}")
    if run.settings is None and config is None:
        typer.echo("left out: its settings, which no report knows; give --config", err=True)
    for note in written.notes:
        typer.echo(f"left out: {note}", err=True)
    if run.incomplete:
        typer.echo(f"left out, since they aren't complete: {', '.join(run.incomplete)}", err=True)


def keep(
    folder: Folder,
    address: Annotated[
        str,
        typer.Argument(metavar="ADDRESS", help="Of this run alone: s3://bucket/folder."),
    ],
) -> None:
    """Bring a run's transports, relit pictures and report into a bucket; captures stay here.

    What is there already isn't sent again, and an upload that was interrupted goes on: run it
    again. Credentials come from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY,
    AWS_REGION and, for servers other than Amazon's, AWS_ENDPOINT_URL. Read what is there with
    rfpipe.open_transport("s3://..."), rfpipe relight and rfpipe verify. A run whose settings have
    storage.keep_at does this by itself, at its end.
    """
    from rfpipe.publishing.keep import keep as bring
    from rfpipe.publishing.run import find_run

    record = bring(find_run(folder), address, lambda name: typer.echo(f"  {name}", err=True))
    typer.echo(
        f"{record.address}: {record.objects:,} objects, {record.nbytes / 1e6:,.1f} MB; sent "
        f"{record.sent:,} of them, {record.nbytes_sent / 1e6:,.1f} MB"
    )
    typer.echo(f"check: {shlex.join(['rfpipe', 'verify', record.address])}")


collection = typer.Typer(
    help="Keep a run's results with what its scenes share stored once, and get them back.",
    no_args_is_help=True,
)


@collection.command()
def pack(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="A run's results.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to make.")],
    transports: Annotated[
        bool,
        typer.Option(
            "--transports", help="Keep transports and manifests alone: all that relighting needs."
        ),
    ] = False,
) -> None:
    """Store a run's files by what they hold, each content once.

    What is the same in many scenes (dark frames, patterns, schedules, calibration) takes its place
    once, and does so still when the folder is copied, zipped or put on a server, where
    rfpipe.open_collection reads it as it lies. 'rfpipe verify' checks it; 'unpack' gives back the
    same files.
    """
    from rfpipe.output import check_no_run, checked_output
    from rfpipe.store.packed import pack as store
    from rfpipe.transport.storage import STORE_NAME

    checked_output("collection pack", output)
    check_no_run(output, "objects")
    if not results.is_dir():
        raise InputError(f"{results}: is no folder; give a run's results")
    if output.absolute().is_relative_to(results.absolute()):
        raise InputError(f"--output {output}: lies in {results}; it would be packed the next time")
    files = [
        file
        for file in results.rglob("*")
        if file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(results).parts)
        and (not transports or STORE_NAME in file.parts or file.name == "transport.json")
    ]
    if not files:
        raise InputError(f"{results}: has no files of a run")
    index = store(results, files, output)
    contents = dict(index.values())
    nbytes, stored = sum(size for _, size in index.values()), sum(contents.values())
    typer.echo(
        f"{output}: {len(index):,} files of {nbytes / 1e6:,.1f} MB as {len(contents):,} "
        f"contents of {stored / 1e6:,.1f} MB; {1 - stored / max(1, nbytes):.0%} are shared"
    )


@collection.command()
def unpack(
    packed: Annotated[
        Path,
        typer.Argument(
            metavar="PACKED", help="What 'pack' made: its folder, a zip file of it, or its address."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write.")],
) -> None:
    """Write the files of a packed run as they were; each is checked."""
    from rfpipe.output import checked_output
    from rfpipe.store.location import locate
    from rfpipe.store.packed import PackedPlace, packed_in
    from rfpipe.store.packed import unpack as write

    checked_output("collection unpack", output)
    place = locate(packed)
    contents = place if isinstance(place, PackedPlace) else packed_in(place)
    if contents is None:
        raise InputError(f"{packed}: is no packed run; 'rfpipe collection pack' makes one")
    write(contents, output)
    typer.echo(f"{output}: {len(contents.index):,} files, {contents.nbytes() / 1e6:,.1f} MB")
