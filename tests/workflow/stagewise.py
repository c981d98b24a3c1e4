"""Acquisitions of a known matrix on files, stage by stage."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from tests.rigs.known_matrix import contents

from rfpipe.config import CameraConfig
from rfpipe.jobs.workers import Resources
from rfpipe.photometry import CameraModel, Sensor
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig
from rfpipe.stages import assemble, capture, merge, normalize, refine, schedule
from rfpipe.stages.acquisition import acquire_transport
from rfpipe.stages.context import Acquisition
from rfpipe.stages.plan import Plan
from rfpipe.stages.rig_sources import GivenRig
from rfpipe.stages.settings import AcquisitionSettings
from rfpipe.storage.files import FolderStorage
from rfpipe.store import StoreLock
from rfpipe.transport import open_transport

SHAPE = (4, 5)
RAYS = 20
CODE = "some code"

CAMERA = CameraModel(**CameraConfig().model_dump())


def symmetric_matrix() -> np.ndarray:
    half = generator(3).random((RAYS, RAYS)) / RAYS
    return half + half.T  # radiance 1 under floodlight, half of the camera's full scale


SETTINGS = AcquisitionSettings(
    code=CODE, all_off_brackets=2, all_on_brackets=2, scene="matrix", progress=False
)


class StagewiseAcquisition:
    """One acquisition of a matrix; each stage runs as if in a separate process."""

    def __init__(
        self, path: Path, rig: Any, tolerance: float | None = 1e-3, method: str = "symmetric"
    ) -> None:
        self.rig = rig
        self.folder = FolderStorage(path)
        options = {} if tolerance is None else {"tolerance": tolerance}
        self.plan = Plan.of(method, method, (SHAPE, SHAPE, 1), options)
        self.resources = Resources()
        self.settings = SETTINGS

    def context(self, **settings: Any) -> Acquisition:
        return Acquisition(
            self.folder, replace(self.settings, **settings), self.resources, GivenRig(self.rig),
            plan=self.plan,
        )  # fmt: skip

    def with_measured_rig(self) -> Acquisition:
        return replace(self.context(), plan=self.plan.for_measured_rig(self.folder))

    def schedule(self, level: int) -> None:
        schedule.run(self.with_measured_rig() if level else self.context(), level)

    def capture(self, level: int, **settings: Any) -> None:
        capture.run(self.context(**settings), level)

    def merge(self, level: int, **settings: Any) -> None:
        merge.run(self.context(**settings), level)

    def normalize(self, level: int) -> None:
        normalize.run(self.with_measured_rig(), level)

    def refine(self, level: int) -> None:
        refine.run(self.with_measured_rig(), level)

    def level(self, level: int) -> None:
        for stage in (self.schedule, self.capture, self.merge, self.normalize, self.refine):
            stage(level)

    def acquire_levels(self) -> None:
        for level in count():
            self.schedule(level)
            if not self.folder.read_manifest(level, "schedule")["patterns"]:
                return
            for stage in (self.capture, self.merge, self.normalize, self.refine):
                stage(level)

    def assemble(self) -> Any:
        assemble.run(self.with_measured_rig())
        return open_transport(self.folder.path / "transport.zarr")


def acquire(
    path: Path,
    rig: Any,
    plan: str | Plan = "symmetric",
    settings: AcquisitionSettings = SETTINGS,
) -> FolderStorage:
    """Start or continue an acquisition of a matrix, like a job of all stages."""
    folder = FolderStorage(path)
    if isinstance(plan, str):
        plan = Plan.of(plan, plan, (SHAPE, SHAPE, 1))
    with StoreLock(path):
        acquire_transport(Acquisition(folder, settings, rig_source=GivenRig(rig), plan=plan))
    return folder


def matrix_rig(matrix: np.ndarray | None = None, noise: Sensor | None = None) -> OperatorRig:
    return OperatorRig(symmetric_matrix() if matrix is None else matrix, SHAPE, SHAPE, noise)


class FaultyRig:
    """A rig whose frames are changed by a function of the key."""

    def __init__(self, rig: OperatorRig, fault: Callable[[tuple[int, ...], Any], Any]) -> None:
        self._rig = rig
        self._fault = fault
        self.shown: list[tuple[int, ...]] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._rig, name)

    def capture(self, patterns: Any, keys: Any) -> Any:
        frames = [
            self._fault(key, self._rig.capture(patterns[i : i + 1], [key])[0])
            for i, key in enumerate(keys)
        ]
        self.shown += keys
        return np.stack(frames)


def stored(path: Path) -> dict[str, bytes]:
    """Bytes of the manifests and stores of an acquisition."""
    files = contents(path)
    return {name: files[name] for name in files if not name.endswith((".log", ".tsv"))}


def damage(store: Path) -> Path:
    chunk = max((path for path in store.rglob("c*") if path.is_file()), key=lambda p: p.name)
    content = chunk.read_bytes()
    chunk.write_bytes(content[: len(content) // 2])
    return chunk
