"""The catalogue: a page with the state of each acquisition."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.results.acquired_collections import acquire_item
from tests.rigs.known_matrix import run

from rfpipe.config import load_config
from rfpipe.report.catalogue import CATALOGUE, write_catalogue
from rfpipe.store import read_manifest, write_manifest
from rfpipe.store.files import hidden_sibling

HEADER = "name,kind,surfaces,shape,channels,about.title\n"
STATES = ("done", "failed", "running", "stopped", "waiting")


@pytest.fixture(scope="module")
def listed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run with a scene in each state, and its page."""
    folder = tmp_path_factory.mktemp("catalogue")
    rows = [f"{name},plane,texture,6 x 8,3,<{name}> & co\n" for name in STATES]
    (folder / "scenes.csv").write_text(HEADER + "".join(rows))
    (folder / "run.yaml").write_text("collection: scenes.csv\nmethods: {hadamard: {}}\n")
    results = folder / "results"
    acquire_item(load_config(folder / "run.yaml"), "done", "hadamard", results)
    for name in ("failed", "running", "stopped"):
        (results / name / "hadamard/L00").mkdir(parents=True)
    log = results / "failed/hadamard/acquire.log"
    log.write_text(
        "2026-01-01 00:00:00,000 INFO level 0\n"
        "2026-01-01 00:00:01,000 ERROR the lamp <went> out; mend it\nTraceback\n  ...\n"
    )
    log = results / "stopped/hadamard/acquire.log"
    log.write_text("2026-01-01 00:00:01,000 WARNING stopped; finished work is kept, and the next\n")
    (results / "stopped/hadamard/L00/capture.json").write_text("{}")
    (results / "report/view").mkdir(parents=True)
    (results / "report/view/done_hadamard.html").write_text("a viewer")
    with hidden_sibling(results / "running/hadamard", "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        lock.write("78 node4\n")
        lock.flush()
        output = run("catalogue", folder / "run.yaml", "--folder", results)
    for name in STATES:
        assert f"1 {name}" in output
    return results / CATALOGUE


def cells(page: Any, column: int) -> list[str]:
    """Return the texts of a column in the visible rows."""
    shown = "[...document.querySelectorAll('tbody tr:not([hidden])')]"
    return list(page.evaluate(f"{shown}.map(row => row.cells[{column}].innerText)"))


def test_the_page_shows_states_sorts_and_filters(chromium: Any, listed: Path) -> None:
    page = chromium.new_context(viewport={"width": 1280, "height": 700}).new_page()
    page_errors: list[str] = []
    requests: list[str] = []
    page.on("pageerror", lambda error: page_errors.append(str(error)))
    page.on("request", lambda request: requests.append(request.url))
    page.goto(f"file://{listed}")
    assert [it.splitlines()[0] for it in cells(page, 1)] == list(STATES)
    assert cells(page, 4)[0] == "<done> & co"
    states = cells(page, 3)
    assert [it.splitlines()[0] for it in states] == list(STATES)
    assert "the lamp <went> out; mend it" in states[1]
    assert "level 0 is captured" in states[3]
    assert "on node4: nothing captured yet" in states[2]
    assert cells(page, 5) == ["59", "", "", "", ""]
    assert float(cells(page, 7)[0]) > 0  # MB
    assert page.evaluate("document.querySelector('img').naturalWidth") == 8
    link = page.evaluate("document.querySelector('tbody a').href")
    assert link == f"file://{listed.parents[1]}/report/view/done_hadamard.html"
    page.click("th:nth-child(2) button")
    page.click("th:nth-child(2) button")
    assert [it.splitlines()[0] for it in cells(page, 1)] == sorted(STATES, reverse=True)
    page.click("th:nth-child(6) button")  # unknown values come last
    page.click("th:nth-child(6) button")
    assert cells(page, 5)[0] == "59"
    page.uncheck("input[value=waiting]")
    page.fill("#text", "lamp <went>")
    assert cells(page, 2) == ["hadamard"]
    assert page.inner_text("#shown") == "1 shown"
    page.set_viewport_size({"width": 400, "height": 700})  # size of a telephone
    right = "document.querySelector('tr:not([hidden]) .state').getBoundingClientRect().right"
    assert 0 < page.evaluate(right) < 400
    assert not page_errors
    assert all(url.startswith("file:") for url in requests)


def test_folders_of_removed_scenes_are_named(listed: Path) -> None:
    settings = listed.parents[2] / "run.yaml"
    (listed.parents[1] / "taken_out/dual/L00").mkdir(parents=True)
    write_catalogue(load_config(settings), listed.parents[1])
    assert "no longer in the settings: taken_out." in listed.read_text()


def test_a_thumbnail_is_updated_with_its_floodlit_image(listed: Path) -> None:
    settings, results = load_config(listed.parents[2] / "run.yaml"), listed.parents[1]
    picture = listed.with_name("done_hadamard.png")
    picture.write_bytes(b"kept")
    write_catalogue(settings, results)
    assert picture.read_bytes() == b"kept"
    (results / "done/hadamard/L00/merge.json").touch()
    write_catalogue(settings, results)
    assert picture.read_bytes() != b"kept"


def test_a_missed_target_is_shown_with_the_state(listed: Path) -> None:
    settings, results = load_config(listed.parents[2] / "run.yaml"), listed.parents[1]
    manifest = results / "done/hadamard/transport.json"
    manifest_bytes = manifest.read_bytes()
    levels = [{"level": 1, "patterns": 59, "estimated_error": 0.02, "ended": "it is <dark>"}]
    facts = {**read_manifest(manifest), "options": {"target_error": 0.01}, "levels": levels}
    try:
        write_manifest(manifest, {key: it for key, it in facts.items() if key != "checksum"})
        write_catalogue(settings, results)
        page = listed.read_text("utf-8")
        assert page.count('<div class="reason missed">') == 1
        assert "TARGET MISSED: the mean error is 2.00 %" in page
        assert "it is &lt;dark&gt;" in page
    finally:
        manifest.write_bytes(manifest_bytes)
    write_catalogue(settings, results)
    assert '<div class="reason missed">' not in listed.read_text("utf-8")
