"""What an acquisition that goes on reads of what it left."""

from pathlib import Path

import numpy as np
import pytest

from rfpipe.errors import DamagedStageError
from rfpipe.methods import get_method
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import AcquisitionFolder, write_result
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


def left_in(path: Path, run: MethodRun) -> AcquisitionFolder:
    """Write what the stages of refinement leave of a run in process."""
    folder = AcquisitionFolder(path)
    for level in range(len(run.packs)):
        folder.manifest(level, "refine").parent.mkdir(parents=True)
        write_refined(folder, run, level)
    return folder


def write_refined(folder: AcquisitionFolder, run: MethodRun, level: int, **arrays: object) -> None:
    """Write what a level's refinement leaves, some of its arrays replaced."""
    pack, after = run.packs[level], level + 1
    write_result(
        folder.manifest(level, "refine"), f"{level}", {**pack.arrays, **arrays},
        {"next": after if after < len(run.packs) else None}, states=[dict(pack.attributes)],
    )  # fmt: skip


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
    ("method", "passing"),
    [("symmetric", "frontier_"), ("dual", "frontier_"), ("near_far", "model_")],
)
def test_what_only_the_next_level_needed_is_not_read_later(
    method: str, passing: str, tmp_path: Path, read: list[tuple[str, str]]
) -> None:
    run = acquired(method)
    folder, plan = left_in(tmp_path, run), Plan.of(method, method, SHAPE, SHAPE, 1)
    last = len(run.packs)
    holders = [
        f"L{level:02d}"
        for level, pack in enumerate(run.packs)
        if any(name.startswith(passing) for name in pack.arrays)
    ]
    found = plan.state_before(folder, None)
    assert len(holders) > 1
    assert {level for level, name in read if name.startswith(passing)} == {holders[-1]}
    assert len(read) == len(set(read))
    expected = plan.method.transport(run.states[last]).toarray()
    np.testing.assert_array_equal(plan.method.transport(found).toarray(), expected)


def test_a_state_is_restored_once(tmp_path: Path, read: list[tuple[str, str]]) -> None:
    """For all stages of a level, unless what it rests on is made anew."""
    run = acquired("symmetric")
    folder, plan = left_in(tmp_path, run), Plan.of("symmetric", "symmetric", SHAPE, SHAPE, 1)
    found = plan.state_before(folder, 2)
    before = len(read)
    assert plan.state_before(folder, 2) is found
    plan.method.schedule(found)
    assert len(read) == before, "a schedule needs no leaves"
    write_refined(folder, run, 0, dark=1 - run.packs[0].arrays["dark"])
    assert (plan.state_before(folder, 2).dark != found.dark).all()


def test_damage_of_what_is_read_names_its_stage(tmp_path: Path) -> None:
    run = acquired("dual")
    folder, plan = left_in(tmp_path, run), Plan.of("dual", "dual", SHAPE, SHAPE, 1)
    chunks = list((folder.store(1, "refine") / "stored_001_values").rglob("*"))
    for chunk in chunks:
        if chunk.is_file() and chunk.name != "zarr.json":
            chunk.write_bytes(b"not a chunk")
    with pytest.raises(DamagedStageError, match="stored_001_values") as told:
        plan.method.transport(plan.state_before(folder, 3))
    assert told.value.manifest == folder.manifest(1, "refine")
