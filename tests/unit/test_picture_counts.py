"""Pictures on the rig, counted by purpose from the manifests of the captures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import IntegrityError
from rfpipe.rigs import OperatorRig
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import PictureCounts, captured_pictures, pictures_of_levels
from rfpipe.store import write_manifest

EXPOSURES = 4


def capture(folder: Path, patterns: int, **parts: int) -> None:
    """Write the manifest of a capture, with a number of brackets of each part."""
    folder.mkdir(parents=True)
    bracket = [EXPOSURES, 8, 10, 3]
    entries = {name: {"digest": "it", "shape": [n, *bracket]} for name, n in parts.items()}
    rig = {"rig": {"shape": [9]}, "sensor": {"digest": "arrays"}}
    facts = {"patterns": patterns, "shape": [patterns, *bracket], **rig, **entries}
    write_manifest(folder / "capture.json", facts)


@pytest.fixture
def storage(tmp_path: Path) -> FolderStorage:
    capture(tmp_path / "L00", 1, reference_brackets=72, symmetry=6)
    capture(tmp_path / "L01", 12, check_pictures=3)
    capture(tmp_path / "L02", 5, reference_brackets=4)
    capture(tmp_path / "verification", 9, check_pictures=2)
    return FolderStorage(tmp_path)


def test_pictures_are_counted_by_purpose(storage: FolderStorage) -> None:
    counts = captured_pictures(storage)
    by_purpose = {"references": 76, "symmetry": 6, "patterns": 18, "checks": 5, "verification": 9}
    assert counts.by_purpose() == by_purpose
    assert counts.total == 114
    assert counts.frames == 114 * EXPOSURES


def test_a_transport_that_ends_earlier_is_verified_by_as_many_pictures(
    storage: FolderStorage,
) -> None:
    first = captured_pictures(storage, 0)
    assert (first.references, first.patterns, first.checks, first.verification) == (72, 1, 2, 9)
    assert pictures_of_levels(storage, 0) == PictureCounts(72, 6, 1, frames=79 * EXPOSURES)


def test_nothing_is_counted_without_captures_and_damage_is_named(tmp_path: Path) -> None:
    assert captured_pictures(FolderStorage(tmp_path)).total == 0
    capture(tmp_path / "L00", 1)
    manifest = tmp_path / "L00" / "capture.json"
    manifest.write_text(manifest.read_text("utf-8").replace("1", "2"), "utf-8")
    with pytest.raises(IntegrityError, match=r"capture\.json"):
        captured_pictures(FolderStorage(tmp_path))


class CountingRig(OperatorRig):
    """A rig that counts the patterns it shows."""

    shown = 0

    def capture(self, patterns, keys):
        self.shown += len(patterns)
        return super().capture(patterns, keys)


@pytest.mark.parametrize("watch", ["off", "warn"])
def test_a_result_counts_every_picture_that_the_rig_took(watch: str) -> None:
    rig = CountingRig(np.eye(20, dtype=np.float32), (4, 5), (4, 5))
    result = rfpipe.acquire(rig, "brute_force", progress=False, watch=watch, verification=3)
    assert result.pictures == rig.shown
    counts = result.picture_counts
    assert (result.patterns, counts.references, counts.verification) == (20, 2, 3)
    assert (counts.checks > 0) == (watch == "warn")
    assert counts.frames == rig.shown  # exact radiance has one exposure
    assert f"20 patterns, {rig.shown} pictures on the rig" in repr(result)
