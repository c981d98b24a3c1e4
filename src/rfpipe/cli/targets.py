"""Checks of what `rfpipe run` passes on to Snakemake, whose own messages would mislead."""

from __future__ import annotations

import difflib
import re
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from rfpipe.errors import InputError

_FORCED = ("--forcerun", "-R")
_RULE = re.compile(r"^(?:rule|checkpoint) (\w+):", re.MULTILINE)
_WITHOUT_VALUE = (
    "--dry-run", "--dryrun", "-n", "--keep-going", "-k", "--forceall", "-F", "--force", "-f",
    "--unlock", "--quiet", "-q", "--verbose", "--printshellcmds", "-p", "--rerun-incomplete",
)  # fmt: skip
"""Options of Snakemake after which a file is a target."""

_OF_STAGES = (
    "assemble", "capture_hardware", "capture_offline", "capture_simulated", "merge", "normalize",
    "refine", "schedule",
)  # fmt: skip
"""Files of the rules that exist where a job is a stage."""


def check_no_settings_file(rest: Sequence[str]) -> None:
    """Raise InputError for a settings file among the targets of a run.

    Parameters
    ----------
    rest : sequence of str
        Arguments of the run without ``--configfile`` and its files.
    """
    for before, word in zip(["-n", *rest], rest, strict=False):
        is_target = not before.startswith("-") or before in _WITHOUT_VALUE
        if is_target and word.endswith((".yaml", ".yml")) and not word.startswith("-"):
            raise InputError(
                f"{word} isn't a target of the run; settings go after --configfile: "
                f"rfpipe run --configfile {word}"
            )


def check_forced_rules(
    passed_on: Sequence[str], rules: Path, jobs: Literal["stage", "acquisition"] | None
) -> None:
    """Raise InputError for a stage after ``--forcerun`` that the run does not have.

    Parameters
    ----------
    passed_on : sequence of str
        Arguments for Snakemake.
    rules : Path
        Folder of the workflow's rules.
    jobs : {"stage", "acquisition"} or None
        What a job is, on which the rules depend; None where that isn't known.
    """
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument(*_FORCED, nargs="*", action="extend", default=[], dest="forced")
    forced: list[str] = parser.parse_known_args(passed_on)[0].forced
    of_acquisition = rules_of(rules / "acquire.smk")
    files = [file for file in sorted(rules.glob("*.smk")) if file.stem != "acquire"]
    every = {name: file.stem for file in files for name in rules_of(file)}
    of_stages = {name for name, stem in every.items() if stem in _OF_STAGES}
    known = {*every, *of_acquisition, "all"}
    if jobs is not None:
        known -= {*of_acquisition} if jobs == "stage" else of_stages
    for name in forced:
        if name in known or "/" in name:
            continue
        if name in of_stages:
            raise InputError(
                f"--forcerun {name}: {', '.join(of_acquisition)} is one job of all stages here; "
                "set resources.jobs to stage in the settings to run a stage of it again"
            )
        nearest = difflib.get_close_matches(name, sorted(known), n=3) or sorted(known)
        raise InputError(
            f"--forcerun {name}: the run has no stage of this name; expected a file of its results "
            f"or a stage, such as {', '.join(nearest)}"
        )


def rules_of(file: Path) -> list[str]:
    """Names of the rules of a file of the workflow."""
    return _RULE.findall(file.read_text(encoding="utf-8"))
