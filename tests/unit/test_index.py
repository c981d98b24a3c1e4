"""The index of tasks and the links of all documents: commands and targets exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from rfpipe.cli import app

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
INDEX = DOCS / "what-you-can-do.md"
PAGES = sorted([*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "config" / "README.md"])
ROWS = [
    [cell.strip() for cell in row.split("|")[1:-1]]
    for row in re.findall(r"^\| (?!task|command).*\|$", INDEX.read_text("utf-8"), re.M)
]
COMMANDS = [command for row in ROWS for command in re.findall(r"`([^`]+)`", row[1])]


def headings(page: Path) -> set[str]:
    """Return the anchors that GitHub generates for a page's headings."""
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)
    titles = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def check_options(command: Any, words: list[str]) -> None:
    """Check that a command has the given options and subcommands."""
    if hasattr(command, "list_commands"):
        context = typer.Context(command)
        assert words[0] in command.list_commands(context)
        check_options(command.get_command(context, words[0]), words[1:])
        return
    options = {name for parameter in command.params for name in parameter.opts} | {"--help"}
    assert {word for word in words if word.startswith("-")} <= options


def test_each_row_has_a_task_a_command_and_a_page() -> None:
    assert len(ROWS) > 35
    for row in ROWS:
        task, command, page = row
        assert task
        assert command.count("`") >= 2, row
        assert "](" in page, row


@pytest.mark.parametrize("line", sorted(set(COMMANDS)))
def test_each_command_exists(line: str) -> None:
    program, *words = shlex.split(line)
    if program == "rfpipe":
        check_options(typer.main.get_command(app), words)
    elif program == "make":
        assert re.search(rf"^{words[0]}:", (ROOT / "Makefile").read_text(), re.M)
    elif program == ".venv/bin/pip":
        assert words[0] == "install"
        assert re.fullmatch(r"\.\[(export|torch)\]", words[1])
    else:
        assert program in (".venv/bin/python", ".venv/bin/jupyter")
        assert (ROOT / words[-1]).is_file()
    files = [word for word in words if word.startswith("config/") and "mine" not in word]
    assert [file for file in files if not (ROOT / file).is_file()] == []


def test_the_index_leads_to_each_command_and_each_page() -> None:
    command: Any = typer.main.get_command(app)
    names = {*command.list_commands(typer.Context(command))} - {"run"}  # run by make run
    used = {line.split()[1] for line in COMMANDS if line.startswith("rfpipe ")}
    assert names - used == set()
    linked = set(re.findall(r"\]\(([\w-]+\.(?:md|ipynb))", INDEX.read_text("utf-8")))
    pages = {page.name for kind in ("*.md", "*.ipynb") for page in DOCS.glob(kind)}
    assert pages - linked == {INDEX.name}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_each_link_resolves(page: Path) -> None:
    wrong = []
    for target in re.findall(r"\]\((?!https?:|mailto:)([^)\s]+)\)", page.read_text("utf-8")):
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists() or (anchor and anchor not in headings(file)):
            wrong.append(target)
    assert wrong == []
