"""``rfpipe collection``: a run's results with what its scenes share kept once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.errors import InputError

if TYPE_CHECKING:
    from rfpipe.store.packed import Sizes

__all__ = ["app"]

app = typer.Typer(
    help="Keep a run's results with what its scenes share stored once, and get them back.",
    no_args_is_help=True,
)

Packed = Annotated[
    Path,
    typer.Argument(
        metavar="PACKED", help="What 'pack' made: its folder, a zip file of it, or its address."
    ),
]


@app.command()
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
    from rfpipe.store.packed import pack as store
    from rfpipe.transport.places import STORE_NAME

    if not results.is_dir():
        raise InputError(f"{results}: is no folder; give a run's results")
    if output.absolute().is_relative_to(results.absolute()):
        raise InputError(f"--output {output}: lies in {results}; it would be packed the next time")
    files = [file for file in results.rglob("*") if file.is_file()]
    inside = [(file, file.relative_to(results).parts) for file in files]
    seen = [(file, parts) for file, parts in inside if not any(p.startswith(".") for p in parts)]
    if transports:
        seen = [
            (file, parts)
            for file, parts in seen
            if STORE_NAME in parts or parts[-1] == "transport.json"
        ]
    if not seen:
        raise InputError(f"{results}: has no files of a run")
    sizes = store(results, [file for file, _ in seen], output, {"of": "results"})
    typer.echo(f"{output}: {_said(sizes)}")


@app.command()
def unpack(
    packed: Packed,
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write.")],
) -> None:
    """Write the files of a packed run as they were; each is checked."""
    from rfpipe.store.locating import locate
    from rfpipe.store.packed import packed_in
    from rfpipe.store.packed import unpack as write

    place = packed_in(locate(packed))
    if place is None:
        raise InputError(f"{packed}: is no packed run; 'rfpipe collection pack' makes one")
    sizes = write(place, output)
    typer.echo(f"{output}: {sizes.files:,} files, {sizes.nbytes / 1e6:,.1f} MB")


def _said(sizes: Sizes) -> str:
    saved = sizes.nbytes - sizes.stored
    return (
        f"{sizes.files:,} files of {sizes.nbytes / 1e6:,.1f} MB as {sizes.objects:,} contents of "
        f"{sizes.stored / 1e6:,.1f} MB; {saved / 1e6:,.1f} MB ({saved / max(1, sizes.nbytes):.0%}) "
        "are shared"
    )
