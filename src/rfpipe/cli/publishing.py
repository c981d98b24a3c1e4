"""``rfpipe publish``, ``keep`` and ``collection``: sharing results."""

from __future__ import annotations

import shlex
import sys
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import typer

from rfpipe.errors import InputError

Folder = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="A run's folder, which contains 'results'.")
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
            help="Zip file (*.zip) or folder to write; default: publication.zip in FOLDER. A zip "
            "can be relit over the network with few requests.",
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
            help="Creator to cite: 'Family, Given; ORCID; affiliation'; may be repeated.",
        ),
    ] = None,
    captured: Annotated[
        bool,
        typer.Option(
            "--captured", help="Include the captured frames and the results of all stages."
        ),
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(help="The run's settings, if it has no report."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an existing publication.")
    ] = False,
) -> None:
    """Write a run's transports, report and pictures as a citable, verifiable crate.

    The crate is a Workflow Run RO-Crate with DataCite metadata, the SHA-256 of every file, and an
    example program that relights it from a folder, a zip file or an address. The command prompts
    for licence and creators once, and saves them in FOLDER/publication.yaml, where title, version
    and further entries can be edited. Without a terminal, give --license and --creator.
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
            answer = typer.prompt(f"{question} (saved in {run.folder / CITATION_FILE})")
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
        typer.echo("omitted: the settings, since there is no report; give --config", err=True)
    for note in written.notes:
        typer.echo(f"omitted: {note}", err=True)
    if run.incomplete:
        typer.echo(f"omitted, since they aren't complete: {', '.join(run.incomplete)}", err=True)


def keep(
    folder: Folder,
    address: Annotated[
        str,
        typer.Argument(metavar="ADDRESS", help="s3://bucket/folder, used by this run only."),
    ],
) -> None:
    """Upload a run's transports, relit pictures and report to a bucket, without captures.

    Unchanged objects aren't sent again; to continue an interrupted upload, run the command again.
    Credentials come from the environment: AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION
    and, for servers other than Amazon's, AWS_ENDPOINT_URL. Read the results with
    rfpipe.open_transport("s3://..."), rfpipe relight and rfpipe verify. With the setting
    storage.keep_at, a run uploads its results automatically at its end.
    """
    from rfpipe.publishing.keep import keep as upload
    from rfpipe.publishing.run import find_run

    summary = upload(find_run(folder), address, lambda name: typer.echo(f"  {name}", err=True))
    typer.echo(
        f"{summary.address}: {summary.objects:,} objects, {summary.nbytes / 1e6:,.1f} MB; sent "
        f"{summary.sent:,} of them, {summary.nbytes_sent / 1e6:,.1f} MB"
    )
    typer.echo(f"check: {shlex.join(['rfpipe', 'verify', summary.address])}")


collection = typer.Typer(
    help="Pack a run's results with equal files stored once, and unpack them.",
    no_args_is_help=True,
)


@collection.command()
def pack(
    results: Annotated[Path, typer.Argument(metavar="RESULTS", help="A run's results.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to create.")],
    transports: Annotated[
        bool,
        typer.Option(
            "--transports", help="Pack only transports and manifests, which suffice for relighting."
        ),
    ] = False,
) -> None:
    """Pack a run's files, storing each content once.

    Files that are equal in many scenes (dark frames, patterns, schedules, calibration) are stored
    once, also when the folder is copied, zipped or put on a server. rfpipe.open_collection reads
    it without unpacking, 'rfpipe verify' verifies it, and 'unpack' restores the same files.
    """
    from rfpipe.output import check_no_run, checked_output
    from rfpipe.store.packed import pack_files
    from rfpipe.transport.storage import STORE_NAME

    checked_output("collection pack", output)
    check_no_run(output, "objects")
    if not results.is_dir():
        raise InputError(f"{results}: isn't a folder; give a run's results")
    if output.absolute().is_relative_to(results.absolute()):
        raise InputError(
            f"--output {output}: is in {results} and would be packed next time; give another"
        )
    files = [
        file
        for file in results.rglob("*")
        if file.is_file()
        and not any(part.startswith(".") for part in file.relative_to(results).parts)
        and (not transports or STORE_NAME in file.parts or file.name == "transport.json")
    ]
    if not files:
        raise InputError(f"{results}: has no files of a run; give a run's results")
    index = pack_files(results, files, output)
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
        typer.Argument(metavar="PACKED", help="A packed folder, a zip file of it, or its address."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write.")],
) -> None:
    """Restore the files of a packed run, and verify each."""
    from rfpipe.output import checked_output
    from rfpipe.store.location import locate
    from rfpipe.store.packed import PackedPlace, packed_in, unpack_files

    checked_output("collection unpack", output)
    place = locate(packed)
    contents = place if isinstance(place, PackedPlace) else packed_in(place)
    if contents is None:
        raise InputError(f"{packed}: isn't a packed run; 'rfpipe collection pack' makes one")
    unpack_files(contents, output)
    typer.echo(f"{output}: {len(contents.index):,} files, {contents.nbytes() / 1e6:,.1f} MB")
