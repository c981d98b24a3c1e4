"""The notebook runs from top to bottom, and shows what its stored outputs do."""

from itertools import groupby
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

pytestmark = pytest.mark.slow

NOTEBOOK = Path(__file__).parents[2] / "docs" / "first_steps.ipynb"


def kinds(cell: nbformat.NotebookNode) -> list[tuple[str, ...]]:
    """In what forms the outputs of a cell are; what is printed may come in one piece or more."""
    found = [(output.output_type, *sorted(output.get("data", ()))) for output in cell.outputs]
    return [form for form, _ in groupby(found)]


@pytest.mark.filterwarnings("default")  # Jupyter's own
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
    shown = [output for _, cell in code for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in shown)
    text = "".join(output.get("text", "") for output in shown)
    assert "rfpipe.picture_weights(picture)" in text
    assert "equal: True" in text
