"""``rfpipe catalogue``: the overview of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rfpipe.cli.arguments import ConfigFile


def catalogue(
    config: ConfigFile,
    folder: Annotated[
        Path, typer.Option(help="Results of the run, which may still be running.")
    ] = Path("results"),
) -> None:
    """Write results/catalogue/index.html: state and thumbnail of each acquisition.

    A run with a collection writes this page at its start and end, also after errors; this command
    writes it at any time. The page can be sorted and filtered in any browser.
    """
    from rfpipe.config import load_config
    from rfpipe.report.catalogue import CATALOGUE, write_catalogue

    counts = write_catalogue(load_config(config), folder)
    summary = ", ".join(f"{count} {state}" for state, count in counts.items() if count)
    typer.echo(f"{folder / CATALOGUE}: {summary}")
