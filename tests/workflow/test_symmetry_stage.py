"""The symmetry test on files: acquisitions by methods that need a coaxial rig."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.workflow.stagewise import (
    RAYS,
    SETTINGS,
    SHAPE,
    StagewiseAcquisition,
    acquire,
    matrix_rig,
    symmetric_matrix,
)

import rfpipe
from rfpipe import open_transport
from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError
from rfpipe.methods import Method, MethodDescription
from rfpipe.methods.brute_force import BruteForce
from rfpipe.methods.symmetric.method import Symmetric, SymmetricOptions
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.references import symmetry
from rfpipe.references.symmetry import Asymmetry
from rfpipe.rigs import OperatorRig
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import FolderStorage
from rfpipe.store import PictureStore, read_manifest

FRAMES = 6


def judge(acquisition: StagewiseAcquisition, accepted: float = 0.05) -> dict[str, Any]:
    asymmetry = symmetry.read_asymmetry(acquisition.folder)
    assert asymmetry is not None
    assert symmetry.is_coaxial(asymmetry, Symmetric(), SymmetricOptions(), accepted)
    facts: dict[str, Any] = acquisition.folder.read_manifest(0, "merge")["symmetry"]
    return facts


def begun(path: Path, matrix: np.ndarray) -> StagewiseAcquisition:
    acquisition = StagewiseAcquisition(path, matrix_rig(matrix, CameraModel()))
    acquisition.schedule(0)
    acquisition.capture(0, symmetry_brackets=FRAMES)
    acquisition.merge(0)
    return acquisition


def acquired(plan: Plan, folder: FolderStorage, rig: OperatorRig, frames: int) -> None:
    """Run all levels of an acquisition."""
    frames = frames if plan.measures_symmetry else 0
    settings = replace(SETTINGS, symmetry_brackets=frames, normalization="none")
    acquire(folder.path, rig, plan, settings)


def crooked() -> np.ndarray:
    return np.asarray(generator(3).random((RAYS, RAYS)) / RAYS)


def test_symmetry_brackets_may_be_deleted_after_the_test(tmp_path: Path) -> None:
    acquisition = begun(tmp_path, symmetric_matrix())
    facts = judge(acquisition)
    acquisition.settings = replace(SETTINGS, keep_raw=False)
    acquisition.merge(0)
    assert PictureStore.open(acquisition.folder.store(0, "symmetry")).dropped
    acquisition.folder.manifest(0, "merge").unlink()
    acquisition.merge(0)
    assert judge(acquisition) == facts
    acquisition.capture(0, symmetry_brackets=FRAMES)  # all are stored
    assert PictureStore.open(acquisition.folder.store(0, "symmetry")).dropped


class Choice(MethodDescription):
    """Symmetric photography on coaxial rigs, brute force on all others."""

    name = "choice"
    title = "Choice"
    colour = "black"
    Options = SymmetricOptions

    def measures_symmetry(self, camera: RayDomain, projector: RayDomain) -> bool:
        return True

    def for_rig(
        self, camera: RayDomain, projector: RayDomain, is_coaxial: bool | None = None
    ) -> Method[Any]:
        return BruteForce() if is_coaxial is False else Symmetric()


@pytest.mark.parametrize("coaxial", [True, False])
def test_a_method_for_all_rigs_continues_as_the_measured_rig_requires(
    tmp_path: Path, coaxial: bool
) -> None:
    matrix = symmetric_matrix() if coaxial else crooked()
    name = f"{__file__}:Choice"
    folder = FolderStorage(tmp_path / "acquired")

    def run() -> str:
        plan = Plan.of("choice", name, (SHAPE, SHAPE, 1))
        acquired(plan, folder, matrix_rig(matrix, CameraModel()), FRAMES)
        return plan.for_measured_rig(folder).method.name

    chosen = run()
    assert chosen == ("symmetric" if coaxial else "brute_force")
    before = folder.manifest(0, "refine").stat().st_mtime_ns
    assert run() == chosen
    assert folder.manifest(0, "refine").stat().st_mtime_ns == before  # nothing to do again
    stored = open_transport(folder.path / "transport.zarr")
    assert read_manifest(folder.path / "transport.json")["acquired_by"] == chosen
    frames = {"all_off_brackets": 2, "all_on_brackets": 2, "progress": False}
    result = rfpipe.acquire(matrix_rig(matrix, CameraModel()), Choice(), **frames)
    assert type(result.transport) is type(stored)


def test_a_rig_is_coaxial_only_within_the_target_error_of_the_method() -> None:
    asymmetry = Asymmetry(0.03, 0.001)
    for target, coaxial in ((None, True), (0.05, True), (0.01, False)):
        options = SimpleNamespace(error_target=target)
        assert symmetry.is_coaxial(asymmetry, Choice(), options, 0.05) is coaxial


def test_a_run_ends_where_its_rig_is_not_coaxial(tmp_path: Path) -> None:
    def run(method: str, frames: int, name: str = "") -> FolderStorage:
        folder = FolderStorage(tmp_path / (name or f"{method}_{frames}"))
        acquired(
            Plan.of(method, method, (SHAPE, SHAPE, 1)),
            folder,
            matrix_rig(crooked(), CameraModel()),
            frames,
        )
        return folder

    with pytest.raises(CaptureError, match=r"not symmetric.*dual"):
        run("symmetric", FRAMES)
    stopped = FolderStorage(tmp_path / f"symmetric_{FRAMES}")
    assert "symmetry" in stopped.read_manifest(0, "merge")
    assert not stopped.manifest(0, "normalize").exists()
    for method, frames in (("symmetric", 0), ("brute_force", FRAMES)):
        folder = run(method, frames)
        assert (folder.path / "transport.json").exists()
        assert "symmetry" not in folder.read_manifest(0, "merge")
        assert not folder.store(0, "symmetry").exists()
    # a refused acquisition continues if the symmetry test is disabled
    folder = run("symmetric", 0, f"symmetric_{FRAMES}")
    assert (folder.path / "transport.json").exists()
