"""Reading a state from the refinements of the levels."""

from pathlib import Path

import numpy as np
import pytest

from rfpipe.errors import DamagedStageError
from rfpipe.methods import get_method
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import FolderStorage
from rfpipe.store import ArrayBundle
from rfpipe.testing.methods import MethodRun, run_method

SHAPE = (5, 6)


def acquired(method: str) -> MethodRun:
    """Acquire a smooth symmetric transport with bright direct light."""
    at = np.indices(SHAPE).reshape(2, -1)
    matrix = 0.01 * np.exp(-np.hypot(*(at[:, :, None] - at[:, None])))
    np.fill_diagonal(matrix, 1.0)
    options = {"target_error": 1e-5} if method == "near_far" else {}
    return run_method(get_method(method), matrix[None], SHAPE, SHAPE, **options)


def stored(path: Path, run: MethodRun) -> FolderStorage:
    """Write the refinements of a run in process."""
    folder = FolderStorage(path)
    for level, change in enumerate(run.changes):
        folder.write(level, "refine", f"{level}", change.arrays, {}, state=dict(change.attributes))
    return folder


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Note the level and the name of each array that is read."""
    noted: list[tuple[str, str]] = []
    reads = ArrayBundle.read

    def noting(bundle: ArrayBundle, name: str) -> np.ndarray:
        noted.append((Path(bundle.path).parent.name, name))
        return reads(bundle, name)

    monkeypatch.setattr(ArrayBundle, "read", noting)
    return noted


@pytest.mark.parametrize(
    ("method", "prefix"),
    [("symmetric", "frontier_"), ("dual", "frontier_"), ("near_far", "model_")],
)
def test_arrays_that_only_the_next_level_needed_are_not_read_later(
    method: str, prefix: str, tmp_path: Path, read: list[tuple[str, str]]
) -> None:
    run = acquired(method)
    folder, plan = stored(tmp_path, run), Plan.of(method, method, (SHAPE, SHAPE, 1))
    levels = len(run.changes)
    holders = [
        f"L{level:02d}"
        for level, change in enumerate(run.changes)
        if any(name.startswith(prefix) for name in change.arrays)
    ]
    state = plan.restored_state(folder, levels)
    assert len(holders) > 1
    assert {level for level, name in read if name.startswith(prefix)} == {holders[-1]}
    assert len(read) == len(set(read))
    expected = plan.method.transport(run.states[levels]).toarray()
    np.testing.assert_array_equal(plan.method.transport(state).toarray(), expected)


def test_leaves_are_read_when_they_are_needed(tmp_path: Path, read: list[tuple[str, str]]) -> None:
    run = acquired("symmetric")
    folder, plan = stored(tmp_path, run), Plan.of("symmetric", "symmetric", (SHAPE, SHAPE, 1))
    state = plan.restored_state(folder, 2)
    plan.method.next_schedule(state)
    assert not [name for _, name in read if name.startswith(("leaves_", "parents_"))]
    plan.method.transport(state)
    assert {level for level, name in read if name.startswith("leaves_")} == {"L00", "L01"}


def test_damage_of_a_state_names_its_stage(tmp_path: Path) -> None:
    run = acquired("dual")
    folder, plan = stored(tmp_path, run), Plan.of("dual", "dual", (SHAPE, SHAPE, 1))
    chunks = list((folder.store(1, "refine") / "stored_values").rglob("*"))
    for chunk in chunks:
        if chunk.is_file() and chunk.name != "zarr.json":
            chunk.write_bytes(b"not a chunk")
    with pytest.raises(DamagedStageError, match="stored_values") as caught:
        plan.method.transport(plan.restored_state(folder, 3))
    assert caught.value.manifest == folder.manifest(1, "refine")
