"""The help of every command on a narrow terminal, and the options of `rfpipe run`."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer
from tests.rigs.known_matrix import run
from typer.testing import CliRunner

from rfpipe.cli import app
from rfpipe.cli.run import _Options
from rfpipe.errors import InputError

WIDTH = 80


def commands(group: Any, *above: str) -> Iterator[tuple[str, ...]]:
    """Names of all commands, of groups too."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, *above, name)
        else:
            yield (*above, name)


COMMANDS = list(commands(typer.main.get_command(app)))


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_no_line_is_broken_twice(command: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(app, [*command, "--help"], env={"COLUMNS": str(WIDTH)}).output
    text = shown.partition("╭")[0]
    assert all(len(line) <= WIDTH for line in shown.splitlines())
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        lines = paragraph.splitlines()
        if any(line.startswith("   ") for line in lines):
            continue  # a table
        for line, next_line in pairwise(lines):
            first = next_line.split()[0]
            # the next word would not have fitted
            assert len(line.rstrip()) + 1 + len(first) > WIDTH - 2, (line, next_line)


def test_the_help_of_run_is_short() -> None:
    shown = CliRunner().invoke(app, ["run", "--help"], env={"COLUMNS": str(WIDTH)}).output
    assert len(shown) < 4000
    for option in ("--configfile", "--directory", "--retake", "--keep-going", "--help-all"):
        assert option in shown


@pytest.mark.parametrize(
    ("arguments", "passed_on", "retake", "inspects"),
    [
        (["--cores", "2"], ["--cores", "2"], [], False),
        (["-n", "--retake", "a/b"], ["-n"], ["a/b"], True),
        (["--retake", "a/b", "a/c/2", "--cores", "1"], ["--cores", "1"], ["a/b", "a/c/2"], False),
        (["x.json", "--config", "seed=3"], ["x.json", "--config", "seed=3"], [], False),
        (["--list-changes=params"], ["--list-changes=params"], [], True),
    ],
)
def test_unknown_options_are_passed_on_to_snakemake(
    arguments: list[str], passed_on: list[str], retake: list[str], inspects: bool
) -> None:
    options = _Options.of(arguments)
    assert (options.passed_on, options.retake, options.inspects) == (passed_on, retake, inspects)


def test_help_all_shows_snakemake_s_options(monkeypatch: pytest.MonkeyPatch) -> None:
    called: list[list[str]] = []
    monkeypatch.setattr(subprocess, "call", lambda command: called.append(command) or 0)
    assert CliRunner().invoke(app, ["run", "--help-all"]).exit_code == 0
    assert called[0][1:] == ["--help"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["mine.yaml"], r"Give a settings file after --configfile: .* --configfile mine\.yaml"),
        (["--cores", "2", "mine.yml"], "--configfile mine.yml"),
        (["--dry-run", "mine.yaml"], "--configfile mine.yaml"),
        (["--forcerun", "merg"], "no stage merg .*such as merge"),
        (["-R", "reprt", "--cores", "1"], "such as report"),
        (["--configfile", "small.yaml", "-R", "merge"], "resources.jobs to stage"),
        (["--configfile", "small.yaml", "-R", "acquir"], "such as acquire"),
        (["--configfile", "stages.yaml", "-R", "acquire"], "the run has no stage acquire"),
    ],
)
def test_a_wrong_target_is_refused_with_suggestions(
    arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = "scenes: {wall: {kind: wedge, surfaces: [texture, white], shape: [6, 8]}}\n"
    Path("small.yaml").write_text(scene)
    Path("stages.yaml").write_text(scene + "resources: {jobs: stage}\n")
    with pytest.raises(InputError, match=message):
        run("run", *arguments)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--profile", "mine.yaml"],
        ["--configfile", "small.yaml", "-R", "results/report/index.html", "report"],
        ["--configfile", "stages.yaml", "--forcerun", "merge", "--cores", "2"],
    ],
)
def test_right_targets_are_passed_on(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = "scenes: {wall: {kind: wedge, surfaces: [texture, white], shape: [6, 8]}}\n"
    Path("small.yaml").write_text(scene)
    Path("stages.yaml").write_text(scene + "resources: {jobs: stage}\n")
    started: list[list[str]] = []
    cli_run = sys.modules["rfpipe.cli.run"]
    monkeypatch.setattr(cli_run, "_status_of", lambda command: started.append(command) or 0)
    run("run", *arguments)
    assert started[0][-len(arguments) :] == arguments
