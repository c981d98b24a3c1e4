"""Settings file of a run as an argument of commands, and the folder of the run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Annotated

import typer

ConfigFile = Annotated[
    Path,
    typer.Argument(metavar="CONFIG", help="Settings file of a run, such as config/config.yaml."),
]


@contextmanager
def working_in(folder: Path, settings: Path) -> Iterator[Path]:
    """Change to a run's folder, to which the file names in its settings are relative.

    Yields
    ------
    Path
        The settings file, relative to the new folder or absolute.
    """
    path = settings.absolute() if folder != Path() else settings
    with chdir(folder if folder.is_dir() else Path()):
        yield path
