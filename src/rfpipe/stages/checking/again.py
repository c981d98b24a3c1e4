"""How a run was started, kept beside its results, so that it can be told how to run it again."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rfpipe.errors import StoreError
from rfpipe.store import read_manifest, write_manifest

__all__ = ["RUN", "run_again", "shell_path", "write_run"]

RUN = "run.json"
"""Lies in ``results``."""


def write_run(
    results: Path, snakefile: Path, configfiles: Iterable[Path], overrides: dict[str, Any]
) -> None:
    """Keep how a run is started; each path as seen from the folder of ``results``, and as it is.

    Parameters
    ----------
    results : Path
    snakefile : Path
    configfiles : iterable of Path
        Those that were given on the command line.
    overrides : dict
        Settings that were given there.
    """
    home = results.resolve().parent

    def seen(path: Path) -> list[str]:
        return [os.path.relpath(path.resolve(), home), str(path.resolve())]

    write_manifest(
        results / RUN,
        {
            "snakefile": seen(snakefile),
            "configfiles": [seen(path) for path in configfiles],
            "config": {name: str(value) for name, value in overrides.items()},
        },
    )


def run_again(results: Path) -> str:
    """Return the shell command that runs a run again, from the present folder."""
    home = results.resolve().parent
    try:
        known = read_manifest(results / RUN)
    except StoreError:
        known = {"snakefile": ["Snakefile"], "configfiles": [], "config": {}}
        if not (home / "Snakefile").is_file():
            return (
                f"{_snakemake()} --directory {shell_path(home)} --configfile SETTINGS_OF_THAT_RUN"
            )
    snakefile = _there(home, known["snakefile"])
    configfiles = [_there(home, names) for names in known["configfiles"]]
    if snakefile.parent == home and not configfiles and not known["config"]:
        there = "" if home == Path.cwd() else f"-C {shell_path(home)} "
        return f"make {there}run"
    words = [_snakemake()]
    if snakefile != Path.cwd() / "Snakefile":
        words += ["--snakefile", shell_path(snakefile)]
    words += ["--directory", shell_path(home)]
    if configfiles:
        words += ["--configfile", *map(shell_path, configfiles)]
    if known["config"]:
        words += ["--config", *(shlex.quote(f"{n}={v}") for n, v in known["config"].items())]
    return " ".join(words)


def _there(home: Path, names: list[str]) -> Path:
    """Return the first of a path's names that leads to a file; a folder may have been moved."""
    places = [(home / name).resolve() for name in names]
    return next((place for place in places if place.is_file()), places[0])


def shell_path(path: Path) -> str:
    """Quote a path for a shell, relative to the present folder where it lies below that."""
    path = Path(os.path.abspath(path))  # noqa: PTH100  # a link stays one
    here = Path.cwd()
    return shlex.quote(str(path.relative_to(here) if path.is_relative_to(here) else path))


def _snakemake() -> str:
    beside = Path(sys.executable).with_name("snakemake")
    found = shutil.which("snakemake")
    return "snakemake" if found or not beside.exists() else shell_path(beside)
