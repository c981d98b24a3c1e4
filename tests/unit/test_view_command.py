"""``rfpipe view``: pages of stored transports, and messages for invalid arguments."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from tests.results.transports import transport_of
from tests.rigs.known_matrix import run

from rfpipe.errors import RfpipeError
from rfpipe.pictures.images import write_image
from rfpipe.transport import save_transport
from rfpipe.viewer import write_acquisition

SHAPE = (20, 24)


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run's folder, in which the command runs."""
    for method in ("symmetric", "near_far"):
        store = tmp_path / "results" / "corner" / method / "transport.zarr"
        save_transport(transport_of(method), store, "uint8", scene="corner", method=method)
    monkeypatch.chdir(tmp_path)
    return tmp_path / "results"


def test_a_page_is_self_contained_and_lists_facts(results: Path) -> None:
    output = run("view", results / "corner" / "symmetric")
    text = Path("corner_symmetric.html").read_text("utf-8")
    assert output.startswith("corner_symmetric.html: ")
    assert "<h1>corner by symmetric</h1>" in text
    assert "20 x 24, 480 rays" in text
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert not re.search(r"https?://", text)


def test_a_transport_or_a_picture_is_compared(results: Path, tmp_path: Path) -> None:
    store, page = results / "corner" / "symmetric" / "transport.zarr", tmp_path / "a.html"
    run("view", store, "-o", page, "--compare", results / "corner" / "near_far", "--title", "A & B")
    text = page.read_text("utf-8")
    assert "Compare with corner by near_far" in text
    assert "<h1>A &amp; B</h1>" in text
    write_image(tmp_path / "truth.exr", transport_of("symmetric").relight(np.ones(SHAPE)))
    run("view", store, "-o", page, "--compare", tmp_path / "truth.exr")
    assert "Compare with truth.exr" in page.read_text("utf-8")


def test_a_large_page_has_only_the_last_level(results: Path) -> None:
    output = run("view", results / "corner" / "symmetric", "--largest", 0.01)
    assert re.search(r"levels \d+\n", output)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["results"], "has 2 transports(.|\\n)*symmetric"),
        (["nothing"], "nothing"),
        (["results/corner/symmetric", "--compare", "small.exr"], r"3 x 4 pixels.*expected 20 x 24"),
        (["results/corner/symmetric", "-o", "page.pdf"], r"\.pdf; expected \.html"),
    ],
)
def test_invalid_arguments_are_explained(results: Path, arguments: list[str], message: str) -> None:
    write_image(Path("small.exr"), np.ones((3, 4, 3), np.float32))
    with pytest.raises(RfpipeError, match=message):
        run("view", *arguments)


def test_the_page_of_a_run_compares_methods_reproducibly(results: Path) -> None:
    stores = [results / "corner" / name / "transport.zarr" for name in ("near_far", "symmetric")]
    first, second = (
        write_acquisition(stores[0], stores[1:], results / folder / "page.html").page.read_text()
        for folder in ("first", "again")
    )
    assert "Compare with corner by symmetric" in first
    assert second == first
