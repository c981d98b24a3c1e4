"""Record of a run's command, ``results/run.json``: the options that start the run again."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rfpipe.errors import StoreError
from rfpipe.store import read_manifest, write_manifest

RUN_RECORD = "run.json"
"""Name of the record, in the folder of results."""

_SNAKEFILE, _CONFIGFILE = "--snakefile", "--configfile"


def program(name: str) -> str:
    """Return the path of a program installed with this Python, or else its path or name."""
    installed = Path(sys.executable).with_name(name)
    return str(installed) if installed.exists() else shutil.which(name) or name


def write_run_record(
    results: Path,
    snakefile: Path,
    configfiles: Iterable[Path],
    overrides: dict[str, Any],
    acquisitions: Iterable[tuple[str, str]] = (),
) -> None:
    """Write the record of a run.

    Files in the run's folder are recorded relative to it, so that the run can be copied or renamed.

    Parameters
    ----------
    results : Path
        Folder of results.
    snakefile : Path
    configfiles : iterable of Path
    overrides : dict
        Settings given on the command line.
    acquisitions : iterable of (str, str)
        Scene and method of each acquisition.
    """
    home = results.resolve().parent
    options = [_SNAKEFILE, _relative_to(home, snakefile)]
    for name, values in (
        (_CONFIGFILE, [_relative_to(home, path) for path in configfiles]),
        ("--config", [f"{name}={value}" for name, value in overrides.items()]),
    ):
        options += [name, *values] if values else []
    pairs = [list(acquisition) for acquisition in acquisitions]
    write_manifest(results / RUN_RECORD, {"options": options, "acquisitions": pairs})


def recorded_acquisitions(results: Path) -> list[tuple[str, str]]:
    """Return scene and method of each acquisition of a run; none without a record."""
    try:
        pairs = read_manifest(results / RUN_RECORD)["acquisitions"]
    except (StoreError, KeyError):
        return []
    return [(scene, method) for scene, method in pairs]


def rerun_command(results: Path) -> str:
    """Return the shell command that starts a run again."""
    home = results.resolve().parent
    try:
        recorded = read_manifest(results / RUN_RECORD)["options"]
    except (StoreError, KeyError):
        recorded = ["--configfile", "SETTINGS_OF_THAT_RUN"]
        return shlex.join([program("rfpipe"), "run", "--directory", str(home), *recorded])
    options, name = list[str](), ""
    for option in recorded:
        name = option if option.startswith("--") else name
        is_path = name in (_SNAKEFILE, _CONFIGFILE) and option != name
        options.append(str(home / option) if is_path else option)
    return shlex.join([program("rfpipe"), "run", "--directory", str(home), *options])


def _relative_to(home: Path, path: Path) -> str:
    """Return the path of a file relative to a folder that contains it, else its absolute path."""
    path = path.resolve()
    return path.relative_to(home).as_posix() if path.is_relative_to(home) else str(path)
