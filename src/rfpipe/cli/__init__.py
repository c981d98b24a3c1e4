"""Command line of rfpipe; each command imports the packages that it needs when it runs."""

from __future__ import annotations

import inspect
import os
import sys
from typing import Annotated

import typer

from rfpipe.cli.catalogue import catalogue
from rfpipe.cli.compare import compare
from rfpipe.cli.fit import fit
from rfpipe.cli.lights import lights
from rfpipe.cli.offline import import_, patterns
from rfpipe.cli.plan import plan
from rfpipe.cli.publishing import collection, keep, publish
from rfpipe.cli.relight import relight
from rfpipe.cli.rig import aim, calibrate, serve
from rfpipe.cli.run import PASSED_ON, run
from rfpipe.cli.settings import settings
from rfpipe.cli.transports import export, info, movie
from rfpipe.cli.verify import verify
from rfpipe.cli.view import view
from rfpipe.errors import RfpipeError
from rfpipe.output import is_full
from rfpipe.version import __version__

__all__ = ["app", "main"]

app = typer.Typer(
    name="rfpipe",
    help="Acquire, inspect and relight the light transport between a projector and a camera.",
    no_args_is_help=True,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
)


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", help="Print rfpipe's version and exit.", is_eager=True)
    ] = False,
) -> None:
    if version:
        typer.echo(f"rfpipe {__version__}")
        raise typer.Exit


app.command(context_settings=PASSED_ON)(run)
app.command()(plan)
app.command()(settings)
app.command()(catalogue)
app.command()(compare)
app.command()(verify)
app.command()(info)
app.command()(relight)
app.command()(export)
app.command()(movie)
app.command()(fit)
app.command()(lights)
app.command()(patterns)
app.command("import")(import_)
app.command()(aim)
app.command()(calibrate)
app.command()(serve)
app.command()(publish)
app.command()(keep)
app.add_typer(collection, name="collection")
app.command()(view)


def _reflow(commands: typer.Typer) -> None:
    """Join the lines of each paragraph in the commands' help, for terminals of any width.

    Indented paragraphs, such as tables, keep their lines.
    """
    for command in commands.registered_commands:
        text = inspect.getdoc(command.callback) if command.callback else None
        paragraphs = (text or "").split("\n\n")
        command.help = "\n\n".join(
            paragraph if paragraph.startswith(" ") else paragraph.replace("\n", " ")
            for paragraph in paragraphs
        )
    for group in commands.registered_groups:
        if group.typer_instance is not None:
            _reflow(group.typer_instance)


_reflow(app)


def main() -> None:
    """Run the command line; an `RfpipeError` prints its message and exits with status 1."""
    try:
        app()
    except RfpipeError as error:
        typer.echo(f"rfpipe: {error}", err=True)
        sys.exit(1)
    except OSError as error:
        if not is_full(error):
            raise
        # at exit, Python flushes the remaining output, which would fail again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        typer.echo(f"rfpipe: a file can't be written: {error}; make room and run again", err=True)
        sys.exit(1)
