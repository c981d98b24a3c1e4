"""Checks of arguments for Snakemake, whose own messages would be misleading."""

from __future__ import annotations

import re
from argparse import ArgumentParser
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import yaml

from rfpipe.errors import InputError
from rfpipe.installation import installing
from rfpipe.text import similar_names

_CLUSTER_EXECUTORS = ("cluster-generic", "slurm")
_FORCED = ("--forcerun", "-R")
_RULE = re.compile(r"^(?:rule|checkpoint) (\w+):", re.MULTILINE)
_WITHOUT_VALUE = (
    "--dry-run", "--dryrun", "-n", "--keep-going", "-k", "--forceall", "-F", "--force", "-f",
    "--unlock", "--quiet", "-q", "--verbose", "--printshellcmds", "-p", "--rerun-incomplete",
)  # fmt: skip
"""Options of Snakemake after which a file is a target."""

_FILES_OF_STAGES = (
    "assemble", "capture_hardware", "capture_offline", "capture_simulated", "merge", "normalize",
    "refine", "schedule",
)  # fmt: skip
"""Files of the rules that exist if a job is a stage."""


def check_no_settings_file(arguments: Sequence[str]) -> None:
    """Raise InputError for a settings file among the targets of a run.

    Parameters
    ----------
    arguments : sequence of str
        Arguments of the run without ``--configfile`` and its files.
    """
    for previous, word in zip(["-n", *arguments], arguments, strict=False):
        is_target = not previous.startswith("-") or previous in _WITHOUT_VALUE
        if is_target and word.endswith((".yaml", ".yml")) and not word.startswith("-"):
            raise InputError(
                f"{word} isn't a target of the run",
                remedy=f"Give a settings file after --configfile: rfpipe run --configfile {word}",
            )


def check_executor(arguments: Sequence[str]) -> None:
    """Raise InputError for an executor of the extra cluster that isn't installed.

    Parameters
    ----------
    arguments : sequence of str
        Arguments for Snakemake.
    """
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--executor", "-e")
    parser.add_argument("--profile", "--workflow-profile", type=Path, action="append", default=[])
    options, _ = parser.parse_known_args(arguments)
    names = [options.executor, *map(_executor_of, options.profile)]
    for name in set(names) & set(_CLUSTER_EXECUTORS):
        if find_spec(f"snakemake_executor_plugin_{name.replace('-', '_')}") is None:
            raise InputError(f"the executor {name} isn't installed", remedy=installing("cluster"))


def _executor_of(profile: Path) -> str | None:
    """Executor of a profile of Snakemake, None without one."""
    try:
        options = yaml.safe_load((profile / "config.yaml").read_bytes())
    except (OSError, yaml.YAMLError):  # Snakemake reports it
        return None
    return str(options.get("executor")) if isinstance(options, dict) else None


def check_forced_rules(
    arguments: Sequence[str], rules: Path, jobs: Literal["stage", "acquisition"] | None
) -> None:
    """Raise InputError for a stage after ``--forcerun`` that the run does not have.

    Parameters
    ----------
    arguments : sequence of str
        Arguments for Snakemake.
    rules : Path
        Folder of the workflow's rules.
    jobs : {"stage", "acquisition"} or None
        Work of one job, on which the rules depend; None if unknown.
    """
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument(*_FORCED, nargs="*", action="extend", default=[], dest="forced")
    forced: list[str] = parser.parse_known_args(arguments)[0].forced
    acquisition_rules = rules_of(rules / "acquire.smk")
    files = [file for file in sorted(rules.glob("*.smk")) if file.stem != "acquire"]
    file_of_rule = {name: file.stem for file in files for name in rules_of(file)}
    stage_rules = {name for name, stem in file_of_rule.items() if stem in _FILES_OF_STAGES}
    names = {*file_of_rule, *acquisition_rules, "all"}
    if jobs is not None:
        names -= {*acquisition_rules} if jobs == "stage" else stage_rules
    for name in forced:
        if name in names or "/" in name:
            continue
        if name in stage_rules:
            raise InputError(
                f"the stage {name} isn't a separate job in this run: all stages are one job, "
                f"{', '.join(acquisition_rules)}",
                place="--forcerun",
                remedy="to repeat one stage, set resources.jobs to stage in the settings",
            )
        examples = similar_names(name, sorted(names), count=3) or sorted(names)
        raise InputError(
            f"the run has no stage {name}",
            place="--forcerun",
            remedy=f"expected a stage, such as {', '.join(examples)}, or a file of the results",
        )


def rules_of(file: Path) -> list[str]:
    """Return the names of the rules in a file of the workflow."""
    return _RULE.findall(file.read_text(encoding="utf-8"))
