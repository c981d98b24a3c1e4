"""Documents: valid settings and commands, and figures that equal the measurements."""

import re
import tomllib
from pathlib import Path

import pandas as pd
import pytest
import typer
import yaml
from benchmarks.measured import FOLDER, PAGES, written
from tests.rigs.known_matrix import settings_of_a_plane

from rfpipe import plugins
from rfpipe.cli import app
from rfpipe.config import Config, parse_rig_config

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "tests" / "examples"
DOCUMENTS = (
    "config/README.md",
    *(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")),
)
BLOCKS = [
    pytest.param(block, id=f"{document}-{index}")
    for document in sorted(DOCUMENTS)
    for index, block in enumerate(
        re.findall(r"^```yaml\n(.*?)^```", (ROOT / document).read_text("utf-8"), re.M | re.S)
    )
]


def texts() -> list[Path]:
    """Return the contents of all text files written by hand, by path."""
    folders = ("benchmarks", "config", "docs", "profiles", "src", "tests", "workflow")
    files = [path for path in ROOT.iterdir() if path.is_file() and path.suffix != ".lock"]
    files += [path for folder in folders for path in (ROOT / folder).rglob("*")]
    kinds = {"", ".cff", ".csv", ".ipynb", ".j2", ".js", ".md", ".py", ".sh", ".toml", ".yaml"}
    return [path for path in files if path.is_file() and path.suffix in kinds]


def test_no_text_installs_rfpipe_from_the_package_index() -> None:
    """On the package index, rfpipe is another program."""
    by_name = re.compile(
        r"""\brfpipe\[[a-z]|\binstall(\s+-\S+)*\s+["'`]?(rfpipe|reflectance-fields)\b"""
    )
    violations = [
        f"{path.relative_to(ROOT)}: {match[0]}"
        for path in texts()
        for match in by_name.finditer(path.read_text("utf-8", errors="ignore"))
        if path != Path(__file__)
    ]
    assert violations == []


def test_there_is_one_way_to_make_a_token() -> None:
    """The command needs no system package and works before rfpipe is installed."""
    way = "python3 -c 'import secrets; print(secrets.token_urlsafe(32))'"
    makes = re.compile(r"openssl rand|uuidgen|/dev/u?random|secrets\.token_\w+\(\d+\)\)'")
    pages = [ROOT / document for document in (*DOCUMENTS, "README.md")]
    pages.append(ROOT / "src" / "rfpipe" / "rigs" / "messages.py")
    lines = [line for page in pages for line in page.read_text("utf-8").splitlines()]
    recipes = [line for line in lines if makes.search(line)]
    assert len(recipes) == 3
    assert [line for line in recipes if way not in line] == []


@pytest.mark.parametrize("block", BLOCKS)
def test_settings_in_documents_are_valid(block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(EXAMPLES)  # the folder of the classes that the documents use
    data = yaml.safe_load(block)
    if set(data) <= set(Config.model_fields):
        settings_of_a_plane(**data)  # some examples show a part of the settings only
    else:
        parse_rig_config(data, "the document")


@pytest.mark.parametrize(
    "page", ["docs/verification.md", pytest.param("docs/sequences.md", marks=pytest.mark.slow)]
)
def test_snippets_run_as_they_are(
    page: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text("utf-8"), re.M | re.S)
    assert blocks
    for block in blocks:
        exec(compile(block, page, "exec"), {})
    if "print(" in "".join(blocks):
        assert "AcquisitionResult" in capsys.readouterr().out


@pytest.mark.parametrize("page", PAGES)
def test_tables_equal_the_measured_files(page: Path) -> None:
    text = (ROOT / page).read_text("utf-8")
    assert len(re.findall(r"^<!-- /", text, re.M)) >= 2
    assert written(text, ROOT / FOLDER) == text


def test_the_opening_page_shows_measured_figures() -> None:
    room = pd.read_csv(ROOT / FOLDER / "default_run.csv").set_index("scene").loc["room"]
    caption = f"{room.patterns} patterns to {100 * room.mean_error:.2f} %"
    assert caption in (ROOT / "README.md").read_text("utf-8")


def test_all_registered_plug_ins_have_tests() -> None:
    page = (ROOT / "docs" / "tests.md").read_text("utf-8")
    files = re.findall(r"`(\w+/test_\w+)`", page)
    assert [name for name in files if not (ROOT / "tests" / f"{name}.py").is_file()] == []
    named = {name for row in re.findall(r"^\| (`[^|]*)\|", page, re.M)
             for name in re.findall(r"`(\w+)`", row)}  # fmt: skip
    kinds = (plugins.METHODS, plugins.SCENES, plugins.PROJECTORS, plugins.CAMERAS)
    registered = {name for kind in kinds for name in plugins.names(kind)}
    command = typer.main.get_command(app)
    registered |= {*command.list_commands(typer.Context(command))}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    registered |= {*project["optional-dependencies"]} - {"dev"}
    assert registered - named == set()
