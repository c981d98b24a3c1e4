"""``rfpipe info``: what a transport is, or which ones lie in a folder."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.errors import InputError, StoreError

if TYPE_CHECKING:
    from rfpipe.transport import Transport

__all__ = ["info", "open_checked", "times"]


def info(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="TRANSPORT|FOLDER",
            help="A transport.zarr that a run left in results/; or a folder, to name those below.",
        ),
    ],
) -> None:
    """Show a transport's shape, channels, bytes and levels; of a folder, name those below it."""
    if not _is_store(path) and path.is_dir():
        below = _transports_below(path)
        if not below:
            raise InputError(f"{path}: no transport lies in this folder or below it")
        for place in below:
            typer.echo(_line(place))
        return
    transport = open_checked(path)
    rows, columns = map(math.prod, (transport.camera_shape, transport.projector_shape))
    dense = rows * columns * transport.channels * 4  # float32
    typer.echo(f"camera     {times(transport.camera_shape)} = {rows:,} rays")
    typer.echo(f"projector  {times(transport.projector_shape)} = {columns:,} rays")
    typer.echo(f"channels   {transport.channels}")
    typer.echo(
        f"bytes      {transport.nbytes:,} ({transport.nbytes / dense:.2%} of a dense matrix)"
    )
    typer.echo()
    typer.echo(transport.levels.to_string(index=False))


def open_checked(path: Path) -> Transport:
    """Open a transport, checked against the manifest that a run left beside it.

    Of a folder that holds one transport, that one is taken.

    Raises
    ------
    InputError
        When it is a folder of several, or of none.
    IntegrityError
        When it is damaged, or another than the manifest's.
    """
    from rfpipe.stages.relight import check_transport
    from rfpipe.store.packed import INDEX
    from rfpipe.transport import open_transport

    if path.is_dir() and not _is_store(path) and not (path / INDEX).is_file():
        below = _transports_below(path)
        if len(below) != 1:
            named = "".join(f"\n  {place}" for place in below) or " none"
            raise InputError(
                f"{path}: is a folder; expected one transport, but below it are{named}"
            )
        path = below[0]
    check_transport(path)
    return open_transport(path)


def times(shape: tuple[int, ...]) -> str:
    """Show a shape, as in ``62 x 70``."""
    return " x ".join(map(str, shape))


def _is_store(path: Path) -> bool:
    return path.suffix == ".zarr" or (path / "zarr.json").exists()


def _transports_below(folder: Path) -> list[Path]:
    from rfpipe.store.packed import packed_in
    from rfpipe.transport.places import transports_in

    packed = packed_in(folder)
    if packed is not None:
        return [folder / name for name in transports_in(packed)]
    return sorted(path for path in folder.rglob("transport.zarr") if path.is_dir())


def _line(path: Path) -> str:
    try:
        transport = open_checked(path)
    except StoreError as error:
        return f"{path}: damaged ({str(error).partition('. ')[0]}); rfpipe verify says more"
    patterns = sum(int(row["patterns"]) for row in transport.level_rows)
    return (
        f"{path}: {times(transport.camera_shape)} rays seen, {times(transport.projector_shape)} "
        f"lit, {transport.channels} channels, {patterns:,} patterns, "
        f"{transport.nbytes / 1e6:.3g} MB"
    )
