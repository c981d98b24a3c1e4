"""``rfpipe acquire``: simulated scenes, several at a time, without a job of the workflow each."""

from __future__ import annotations

import signal
from contextlib import chdir
from pathlib import Path
from typing import Annotated

import typer

from rfpipe.cli.parallel import PROCESSES, WorkersOption, resources_of
from rfpipe.errors import RfpipeError

__all__ = ["acquire"]


def acquire(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A YAML file of settings.")],
    directory: Annotated[
        Path,
        typer.Option(
            help="Folder in which results/ lies, and to which the settings' files are relative, as "
            "Snakemake's --directory."
        ),
    ] = Path(),
    workers: WorkersOption = PROCESSES,
) -> None:
    """Acquire the simulated scenes of a settings file on workers, a whole acquisition each.

    For collections of many small scenes, whose jobs take longer to start than to run. The files
    are those of 'rfpipe run', which then has the report left to make. An acquisition that was cut
    off goes on where it stopped, by this command or by 'rfpipe run'.
    """
    from rfpipe.config import load_config
    from rfpipe.stages.acquisitions import acquire_all

    config = config.absolute()
    directory.mkdir(parents=True, exist_ok=True)
    with chdir(directory):
        settings = load_config(config)
        resources = resources_of(workers)
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as by Ctrl-C
        try:
            found = acquire_all(settings, Path("results"), resources)
        except KeyboardInterrupt:
            typer.echo("rfpipe: stopped; what is done is kept, and running again goes on", err=True)
            raise typer.Exit(130) from None
    failed = [one for one in found if one.error]
    for one in failed:
        typer.echo(f"{one.scene} by {one.method}: {one.error}", err=True)
    if failed:
        raise RfpipeError(
            f"{len(failed)} of {len(found)} acquisitions failed, as said above; what is done of "
            "them is kept, and running again goes on from there"
        )
    typer.echo(f"{directory / 'results'}: {len(found)} acquisitions")
