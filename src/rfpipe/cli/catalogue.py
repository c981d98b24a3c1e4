"""``rfpipe catalogue``: the page that lists all acquisitions of a run, at any time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

__all__ = ["catalogue"]

_MOST_NAMED = 8


def catalogue(
    config: Annotated[Path, typer.Argument(metavar="CONFIG", help="A YAML file of settings.")],
    folder: Annotated[
        Path, typer.Option(help="The run's results, finished or not, or while it runs.")
    ] = Path("results"),
    every: Annotated[
        float,
        typer.Option(min=0, help="Write it again every so many seconds, until Ctrl-C; 0: once."),
    ] = 0.0,
) -> None:
    """Write results/catalogue/index.html: what became of each acquisition, with a small picture.

    A run with a collection writes it when it begins and when it ends, however it ends; this command
    writes it at any time. Sort and filter it in any browser.
    """
    from rfpipe.config import load_config
    from rfpipe.report.catalogue import CATALOGUE, left_over, write_catalogue

    settings = load_config(config)
    while True:
        counts = write_catalogue(settings, folder)
        said = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
        typer.echo(f"{folder / CATALOGUE}: {said}")
        if left := left_over(settings, folder):
            names = ", ".join(left[:_MOST_NAMED]) + " ..." * (len(left) > _MOST_NAMED)
            typer.echo(
                f"no scenes of {config} any more, though {folder} has their folders: {names}. What "
                "they hold is kept, verified and published, until you remove it"
            )
        if not every:
            return
        time.sleep(every)
