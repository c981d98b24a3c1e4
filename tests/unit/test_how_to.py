"""Code blocks of the how-to pages run as they are, in the folder that the page describes."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from tests.results import how_to_folders as prepared
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@dataclass(frozen=True)
class HowTo:
    """A page, and what its blocks need.

    Attributes
    ----------
    prepare : function
        Writes the files with which the page begins into a folder.
    names : function
        Returns the variables with which its Python blocks begin.
    elsewhere : mapping
        A part of each block that isn't run here, to the test that runs it, or to the reason why
        none does.
    """

    prepare: Callable[[Path], None] = lambda folder: None
    names: Callable[[], dict[str, Any]] = dict
    elsewhere: Mapping[str, str] = field(default_factory=dict)


PAGES = {
    "calibration": HowTo(
        elsewhere={"make calibrate": "workflow/test_calibrate", "rfpipe aim": "server/test_aim"}
    ),
    "clusters": HowTo(
        elsewhere={
            "--profile": "workflow/test_slurm",
            "set-resources": "settings of a cluster's profile",
            "groups:": "settings of a cluster's profile",
        }
    ),
    "collections": HowTo(
        prepared.positions,
        prepared.names_of_collections,
        {
            "collection: collection.csv": "settings, read by unit/test_collection_file",
            "rfpipe plan": "workflow/test_collection",
            "did you mean": "a message, of unit/test_collection_file",
            "placing:": "unit/test_placing",
            "rfpipe catalogue": "unit/test_catalogue",
        },
    ),
    "devices": HowTo(
        elsewhere={
            "CameraContract": "device/test_own_devices",
            "pytest": "device/test_own_devices",
            "faults": "unit/test_testing_faults",
        }
    ),
    "errors": HowTo(prepared.relit_run),
    "export": HowTo(prepared.exportable, prepared.names_of_export),
    "install": HowTo(
        elsewhere=dict.fromkeys(("pip install", "uvx"), "release/test_installed"),
    ),
    "light_fields": HowTo(prepared.light_field),
    "methods/your_own": HowTo(elsewhere={"MethodContract": "workflow/test_own_method"}),
    "museums": HowTo(prepared.coin, elsewhere={"npm": "needs the registry of npm"}),
    "night": HowTo(prepared.settings, elsewhere={"--retake": "unit/test_retake"}),
    "parallel": HowTo(elsewhere={"distributed:": "settings of dask"}),
    "photographs": HowTo(prepared.photographs, lambda: {"row": 20, "column": 20}),
    "pictures": HowTo(
        prepared.matrix_and_pictures,
        lambda: {"rfpipe": rfpipe},
        {"rfpipe import": "workflow/test_offline"},
    ),
    "publish": HowTo(
        prepared.publishable,
        elsewhere={"--directory again": "workflow/test_publish", "s3:": "unit/test_remote"},
    ),
    "rig": HowTo(elsewhere={"": "workflow/test_rig_document"}),
    "scenes": HowTo(
        prepared.niche,
        elsewhere=dict.fromkeys(
            ("class Niche", "from niche", "from rfpipe import", "SceneContract"),
            "unit/test_scene_document",
        ),
    ),
    "sequences": HowTo(
        elsewhere={"import rfpipe": "unit/test_documents", "white black": "a list of pictures"}
    ),
    "server": HowTo(elsewhere={"rfpipe serve": "server/test_api", "RemoteRig": "server/test_api"}),
    "stores": HowTo(
        names=prepared.names_of_stores,
        elsewhere={"rfpipe keep": "unit/test_keep", "s3:": "unit/test_keep"},
    ),
    "uses": HowTo(
        prepared.a_transport, prepared.names_of_uses, {"import torch": "unit/test_interop"}
    ),
    "verification": HowTo(elsewhere={"": "unit/test_documents"}),
    "verify": HowTo(prepared.acquire_planes, elsewhere={"mend:": "a message of the command"}),
    "viewer": HowTo(prepared.acquire_planes),
}


def blocks(page: str) -> list[tuple[str, str]]:
    """Return language and text of each block of commands or Python of a page, in their order."""
    text = (DOCS / f"{page}.md").read_text("utf-8")
    block = re.compile(r"^```(sh|python)\n(.*?)^```|(?<=\n\n)((?: {4} *\S[^\n]*\n)+)", re.M | re.S)
    fences = re.sub(r"^```(?!sh|python)(\w+)\n.*?^```", "", text, flags=re.M | re.S)
    return [
        (found[1], found[2]) if found[1] else ("sh", re.sub(r"^ {4}", "", found[3], flags=re.M))
        for found in block.finditer(fences)
    ]


def run(command: str) -> None:
    """Run a command of rfpipe; workflows in a process of their own."""
    words = shlex.split(command, comments=True)
    if not words:
        return
    program, *words = words
    assert Path(program).name == "rfpipe", command
    if words[0] == "run":
        subprocess.run([sys.executable, "-m", "rfpipe.cli", *words], check=True)
        return
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, (command, done.output, done.exception)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_blocks_run_in_their_order(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    how_to = PAGES[page]
    how_to.prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    names = how_to.names()
    for language, text in blocks(page):
        if any(part in text for part in how_to.elsewhere):
            continue
        if language == "python":
            exec(compile(text, page, "exec"), names)
        else:
            for line in text.replace("\\\n", "").splitlines():
                run(line)


def test_all_pages_with_blocks_are_in_the_table() -> None:
    pages = {path.relative_to(DOCS).with_suffix("").as_posix() for path in DOCS.rglob("*.md")}
    written = {page for page in pages if not page.startswith("site/generated/")}
    assert {page for page in written if blocks(page)} == set(PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_blocks_that_run_elsewhere_have_a_test_or_a_reason(page: str) -> None:
    texts = [text for _, text in blocks(page)]
    assert texts
    for part, place in PAGES[page].elsewhere.items():
        assert any(part in text for text in texts), part
        assert " " in place or (ROOT / "tests" / f"{place}.py").is_file(), place
