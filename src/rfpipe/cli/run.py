"""``rfpipe run``: the workflow, with settings checked first and its report named afterwards."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import chdir, contextmanager
from pathlib import Path
from typing import Annotated

import typer

from rfpipe.errors import InputError

__all__ = ["PASSED_ON", "Directory", "run", "working_in"]

Directory = Annotated[
    Path,
    typer.Option("--directory", "-d", help="The run's folder, as 'rfpipe run' takes it."),
]

PASSED_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}
"""How the command is registered: all that follows its name is for Snakemake."""

_REPORT = Path("results") / "report" / "index.html"
_CONFIGS, _DIRECTORY = ("--configfile", "--configfiles"), ("--directory", "-d")


def run(context: typer.Context) -> None:
    """Run the workflow of this folder; options are Snakemake's, as --directory and --configfile.

    The settings are checked first, so that what is wrong is said with its file and line. At the
    end the report's path is printed.
    """
    if not Path("Snakefile").is_file() and not {"-s", "--snakefile"} & set(context.args):
        raise InputError("Snakefile: isn't here; run this in rfpipe's folder, or give --snakefile")
    from rfpipe.config import load_config, read_yaml

    files = list(_values(context.args, _CONFIGS))
    folder = Path(next(reversed([*_values(context.args, _DIRECTORY)]), ""))
    for file in files:
        read_yaml(file)
    if len(files) == 1:
        with working_in(folder, Path(files[0])) as settings:
            load_config(settings)
    beside = Path(sys.executable).with_name("snakemake")
    program = str(beside) if beside.exists() else shutil.which("snakemake") or "snakemake"
    ended = _to_its_end([program, *context.args])
    if ended:
        raise typer.Exit(ended if ended > 0 else 1)
    report = folder / _REPORT
    if report.is_file():
        typer.echo(f"report: {os.path.normpath(report)}")


@contextmanager
def working_in(folder: Path, settings: Path) -> Iterator[Path]:
    """Go to a run's folder, where the files are looked for that its settings name.

    Yields the settings' path as it is from there.
    """
    from_there = settings.absolute() if folder != Path() else settings
    with chdir(folder if folder.is_dir() else Path()):
        yield from_there


def _to_its_end(command: list[str]) -> int:
    """Run a program to its own end and return its status, whatever signals come.

    Ctrl-C reaches it as well, from the terminal; SIGTERM is passed on. It ends its jobs by itself.
    """
    process = subprocess.Popen(command)
    # handlers, which a program that is started doesn't inherit
    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, lambda *_: None),
        signal.SIGTERM: signal.signal(signal.SIGTERM, lambda *_: process.terminate()),
    }
    try:
        return process.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _values(arguments: Sequence[str], names: Sequence[str]) -> Iterator[str]:
    """Yield the values of an option, however it is written; of one that takes several, all."""
    taking = False
    for argument in arguments:
        name, equals, value = argument.partition("=")
        if name in names and equals:
            yield value
            taking = False
        elif argument.startswith("-"):
            taking = argument in names
        elif taking:
            yield argument
            taking = names is _CONFIGS
