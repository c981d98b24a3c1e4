"""The notebook runs, meets its target error, and reproduces its stored outputs."""

import re
from itertools import groupby
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.slow

NOTEBOOK = Path(__file__).parents[2] / "docs" / "first_steps.ipynb"


def kinds(cell: nbformat.NotebookNode) -> list[tuple[str, ...]]:
    """Return the types of a cell's outputs; printed text may come in several pieces."""
    forms = [(output.output_type, *sorted(output.get("data", ()))) for output in cell.outputs]
    return [form for form, _ in groupby(forms)]


NUMBER = re.compile(r"-?\d[\d,]*\.?\d*(?:e[-+]\d+)?")


def check_alike(after: str, before: str) -> None:
    """Check that texts are equal and their numbers agree within differences of processors."""
    advice = (
        "it is not what the notebook shows; run jupyter execute --inplace docs/first_steps.ipynb"
    )
    assert NUMBER.sub("#", after).split() == NUMBER.sub("#", before).split(), advice
    numbers = [
        [float(number.replace(",", "")) for number in NUMBER.findall(text)]
        for text in (after, before)
    ]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.25, abs=0.01), advice


def texts(cell: nbformat.NotebookNode) -> str:
    """Return the text that a cell prints or shows."""
    shown = [
        output.get("text", output.get("data", {}).get("text/plain", "")) for output in cell.outputs
    ]
    return "\n".join(shown)


@pytest.mark.filterwarnings("default")  # warnings of Jupyter
def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("IPYTHONDIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    stored = nbformat.read(NOTEBOOK, as_version=4)
    run = nbformat.from_dict(stored)
    NotebookClient(run, timeout=300, kernel_name="python3").execute(cwd=str(tmp_path))
    code = [
        (before, after)
        for before, after in zip(stored.cells, run.cells, strict=True)
        if before.cell_type == "code"
    ]
    assert len(code) >= 8
    for before, after in code:
        assert kinds(after) == kinds(before), before.source
        check_alike(texts(after), texts(before))
    shown = [output for _, cell in code for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in shown)
    text = "".join(output.get("text", "") for output in shown)
    assert "rfpipe.picture_weights(picture)" in text
    assert "equal: True" in text
    target, estimated, true = map(
        float,
        re.search(r"target (.*) %, estimated (.*) %, true (.*) %", text).groups(),  # type: ignore[union-attr]
    )
    assert max(estimated, true) <= target
