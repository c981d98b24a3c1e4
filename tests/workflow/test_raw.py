"""Runs that delete their brackets after merging them."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.workflow.harness import Workflow
from tests.workflow.stagewise import (
    CAMERA,
    SETTINGS,
    SHAPE,
    FaultyRig,
    StagewiseAcquisition,
    contents,
    damage,
    matrix_rig,
    symmetric_matrix,
)

from rfpipe.errors import IntegrityError, StaleStoreError, StoreError
from rfpipe.rigs import OperatorRig
from rfpipe.storage import files
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.retake import Retake
from rfpipe.store import PictureStore, drop, read_manifest

RAW = ("L00/reference_brackets.zarr", "L00/capture.zarr", "L01/capture.zarr")


@pytest.fixture
def acquisition(tmp_path: Path) -> StagewiseAcquisition:
    """An acquisition of two levels without brackets; its rig counts further patterns."""
    acquisition = StagewiseAcquisition(tmp_path / "mine", matrix_rig(noise=CAMERA))
    acquisition.settings = replace(SETTINGS, keep_raw=False)
    for level in (0, 1):
        acquisition.level(level)
    acquisition.rig = FaultyRig(matrix_rig(noise=CAMERA), lambda key, frame: frame)
    return acquisition


def chunks(folder: Path) -> list[str]:
    return sorted(
        str(path.relative_to(folder)) for name in RAW for path in (folder / name).glob("c.*")
    )


def everything(folder: Path, but: tuple[str, ...] = ()) -> dict[str, bytes]:
    return {name: content for name, content in contents(folder).items() if not name.startswith(but)}


def test_results_are_the_same_without_raw_exposures(
    acquisition: StagewiseAcquisition, tmp_path: Path
) -> None:
    complete = StagewiseAcquisition(tmp_path / "kept", matrix_rig(noise=CAMERA))
    for level in (0, 1):
        complete.level(level)
    assert len(chunks(complete.folder.path)) > 4
    assert chunks(acquisition.folder.path) == []
    assert everything(acquisition.folder.path, RAW) == everything(complete.folder.path, RAW)
    raw = PictureStore.open(acquisition.folder.path / RAW[2])
    assert raw.dropped
    assert raw.complete
    with pytest.raises(StoreError, match="4 items were dropped after they had been used"):
        raw.read(0, 1)


def test_every_stage_can_run_again_without_new_pictures(acquisition: StagewiseAcquisition) -> None:
    before = everything(acquisition.folder.path)
    for level in (0, 1):
        for stage in ("schedule", "capture", "merge", "normalize", "refine"):
            acquisition.folder.manifest(level, stage).unlink()
            getattr(acquisition, stage)(level)
    assert acquisition.rig.shown == []
    assert everything(acquisition.folder.path) == before


def test_merged_images_persist_after_a_change_of_the_code(
    acquisition: StagewiseAcquisition, caplog: pytest.LogCaptureFixture
) -> None:
    before = everything(acquisition.folder.path)
    acquisition.settings = replace(acquisition.settings, code="other code")
    with caplog.at_level(logging.WARNING, logger="rfpipe"):
        for level in (0, 1):
            acquisition.merge(level)
    assert everything(acquisition.folder.path) == before
    assert caplog.text.count("merged by an earlier version of the code and kept") == 2


def test_other_merge_settings_need_the_raw_exposures(acquisition: StagewiseAcquisition) -> None:
    before = everything(acquisition.folder.path)
    for level in (0, 1):
        with pytest.raises(StaleStoreError, match="mask_defects True -> False") as error:
            acquisition.merge(level, mask_defects=False)
        assert "capture.keep_raw is false" in str(error.value)
        assert "Set that back and run again" in str(error.value)
        assert acquisition.folder.retake_command() in str(error.value)
        acquisition.merge(level)  # with the previous settings
    assert everything(acquisition.folder.path) == before

    # as the message advises
    for level in (0, 1):
        Retake(acquisition.folder, level).set_aside()
    for level in (0, 1):
        acquisition.capture(level)
        acquisition.merge(level, mask_defects=False)
    assert len(acquisition.rig.shown) == 2 + 2 + 1 + 4
    assert chunks(acquisition.folder.path) == []


@pytest.mark.parametrize("store", ["merge", "sums", "reference_images"])
def test_damaged_merged_images_need_the_raw_exposures(
    acquisition: StagewiseAcquisition, store: str
) -> None:
    level = 0 if store == "reference_images" else 1
    damage(acquisition.folder.store(level, store))
    acquisition.folder.manifest(level, "merge").unlink()  # as the message advises
    with pytest.raises(StaleStoreError, match=r"damaged.*To capture all levels again"):
        acquisition.merge(level)
    PictureStore.discard(acquisition.folder.store(level, store))
    with pytest.raises(StaleStoreError, match="To capture all levels again"):
        acquisition.merge(level)


def test_changed_patterns_are_captured_again(
    acquisition: StagewiseAcquisition, caplog: pytest.LogCaptureFixture
) -> None:
    acquisition.rig = OperatorRig(symmetric_matrix(), SHAPE, SHAPE, CAMERA, seed=5)
    with pytest.raises(StaleStoreError, match="old ones were dropped after their merge"):
        acquisition.capture(0, when_patterns_change="refuse")
    with caplog.at_level(logging.WARNING, logger="rfpipe"):
        acquisition.capture(0)
    assert "CAPTURING AGAIN" in caplog.text
    assert "were dropped after their merge" in caplog.text
    acquisition.merge(0)
    assert chunks(acquisition.folder.path) == []


class Killed(BaseException):
    """Simulated end of the process; no code under test catches it."""


def killed(*_: Any) -> None:
    raise Killed


@pytest.mark.parametrize("snakemake_removes_the_manifest", [True, False])
@pytest.mark.parametrize(
    "where", ["before", "the merged to the disk", "the marker", "the first file", "the third file"]
)
@pytest.mark.parametrize("level", [0, 1])
def test_a_kill_while_dropping_loses_nothing(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    acquisition: StagewiseAcquisition,
    where: str,
    level: int,
    snakemake_removes_the_manifest: bool,
) -> None:
    undisturbed = everything(acquisition.folder.path)
    cut = StagewiseAcquisition(tmp_path / "cut", matrix_rig(noise=CAMERA))
    cut.settings = replace(SETTINGS, keep_raw=False)
    for above in range(level):
        cut.level(above)
    cut.schedule(level)
    cut.capture(level)
    with monkeypatch.context() as patch:
        if where == "before":
            patch.setattr(FolderStorage, "drop_raw", killed)
        elif where == "the merged to the disk":
            patch.setattr(files, "to_disk", killed)
        elif where == "the marker":
            patch.setattr("rfpipe.store.pictures.write_manifest", killed)
        else:
            remove, removable = Path.unlink, iter(range(0 if where == "the first file" else 2))

            def unlink(path: Path, **named: Any) -> None:
                if path.name.startswith("c.") and next(removable, None) is None:
                    raise Killed
                remove(path, **named)

            patch.setattr(Path, "unlink", unlink)
        with pytest.raises(Killed):
            cut.merge(level)
    assert cut.folder.manifest(level, "merge").exists()
    if snakemake_removes_the_manifest:  # it removes outputs of incomplete jobs
        cut.folder.manifest(level, "merge").unlink()
    cut.merge(level)
    for remaining in range(level, 2):
        cut.level(remaining)
    assert everything(cut.folder.path) == undisturbed


def test_only_a_complete_store_can_be_dropped(tmp_path: Path) -> None:
    frames = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    path = tmp_path / "s"
    with PictureStore.create(path, (2, 3, 4), np.uint16, "abc", {}) as store:
        store.write(0, frames[:1])
        with pytest.raises(StoreError, match="is writing this store"):
            drop(path)
    with pytest.raises(StoreError, match="only the items of a complete store"):
        drop(path)
    with PictureStore.create(path, (2, 3, 4), np.uint16, "abc", {}) as store:
        store.write(1, frames[1:])
        digest = store.digest()
    size = sum(path.stat().st_size for path in path.glob("c.*"))
    assert drop(path) == size
    assert drop(path) == 0
    with PictureStore.create(path, (2, 3, 4), np.uint16, "abc", {}) as store:
        assert store.complete
        assert store.digest() == digest == read_manifest(path / "dropped.json")["digest"]
        with pytest.raises(StoreError, match="captured already"):
            store.write(0, frames[:1])
    (path / "journal.jsonl").write_text("")
    with pytest.raises(IntegrityError, match="damaged journal of a store whose items were dropped"):
        PictureStore.open(path)


@pytest.mark.slow
def test_a_run_can_delete_its_raw_exposures(copy: Workflow, undisturbed: Workflow) -> None:
    folder = copy.path("tiny/symmetric")
    copy.configure(capture={"keep_raw": False})
    output = copy.run("results/tiny/symmetric/raw_dropped")  # only deletes exposures
    assert output.count("brackets dropped") == 4
    assert "patterns in" not in output
    assert list(folder.glob("L*/capture.zarr/c.*")) == []
    remaining, expected = copy.contents("tiny/symmetric"), undisturbed.contents("tiny/symmetric")
    raw = re.compile(r"L\d\d/(capture|reference_brackets|symmetry)\.zarr/c\.")
    assert {name for name in expected if name not in remaining} == set(filter(raw.match, expected))
    assert all(content == expected.get(name, content) for name, content in remaining.items())
