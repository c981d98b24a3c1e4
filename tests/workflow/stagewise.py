"""One acquisition, stage by stage on files, of a known matrix."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tests.rigs.known_matrix import contents

from rfpipe.config import CameraConfig
from rfpipe.jobs.workers import Resources
from rfpipe.photometry import CameraModel, Sensor
from rfpipe.provenance import generator
from rfpipe.rigs import OperatorRig
from rfpipe.stages import (
    acquisition,
    assemble,
    capture,
    merge,
    normalize,
    refine,
    schedule,
)
from rfpipe.stages.plan import Plan
from rfpipe.storage.files import AcquisitionFolder
from rfpipe.store import StoreLock
from rfpipe.transport import open_transport

SHAPE = (4, 5)
RAYS = 20
CODE = "some code"

CAMERA = CameraModel(**CameraConfig().model_dump())


def symmetric_matrix() -> np.ndarray:
    half = generator(3).random((RAYS, RAYS)) / RAYS
    return half + half.T  # radiance 1 under floodlight, half of what the camera can see


class Acquisition:
    """One acquisition of a matrix, stage by stage, each as if in a process of its own."""

    def __init__(
        self, path: Path, rig: Any, tolerance: float | None = 1e-3, method: str = "symmetric"
    ) -> None:
        self.rig = rig
        self.folder = AcquisitionFolder(path)
        options = {} if tolerance is None else {"tolerance": tolerance}
        self.plan = Plan(method, method, SHAPE, SHAPE, 1, options)
        self.resources = Resources()
        self.keep_raw = True
        self.watching: dict[str, Any] | None = None
        self.code = CODE

    def schedule(self, level: int) -> None:
        schedule.run(copy(self.plan), self.folder, level, CODE)

    def capture(self, level: int, **options: Any) -> None:
        options = {"resources": self.resources, "watching": self.watching, **options}
        capture.run(self.rig, self.folder, level, references=(2, 2), **options)

    def merge(self, level: int, mask_defects: bool = True, **options: Any) -> None:
        merge.run(
            self.folder, level,
            mask_defects=mask_defects, code=self.code,
            keep_raw=self.keep_raw, resources=self.resources, **options,
        )  # fmt: skip

    def normalize(self, level: int) -> None:
        normalize.run(copy(self.plan), self.folder, level, mode="per_channel", code=CODE)

    def refine(self, level: int) -> None:
        refine.run(copy(self.plan), self.folder, level, CODE)

    def level(self, level: int) -> None:
        for stage in (self.schedule, self.capture, self.merge, self.normalize, self.refine):
            stage(level)

    def assemble(self) -> Any:
        assemble.run(
            copy(self.plan), self.folder, scene="matrix", number_format="float32", code=CODE
        )
        return open_transport(self.folder.path / "transport.zarr")


def stages(capture: dict[str, Any] | None = None, **merge: Any) -> dict[str, dict[str, Any]]:
    """Settings of the stages of an acquisition as in `Acquisition`, but for changes."""
    code = {"code": CODE}
    watching = {"mode": "warn", "check_interval": 0}
    return {
        "schedule": code,
        "capture": {"references": (2, 2), "watching": watching, **(capture or {})},
        "merge": {"mask_defects": True, **code, **merge},
        "normalize": {"mode": "per_channel", **code},
        "refine": code,
        "assemble": {"scene": "matrix", "number_format": "float32", **code},
    }


def acquire(
    path: Path,
    rig: Any,
    plan: str | Plan = "symmetric",
    settings: dict[str, dict[str, Any]] | None = None,
) -> AcquisitionFolder:
    """Acquire a matrix, or what is missing of it, as a job of all stages does."""
    folder = AcquisitionFolder(path)
    if isinstance(plan, str):
        plan = Plan(plan, plan, SHAPE, SHAPE, 1)
    with StoreLock(path):
        acquisition.run(plan, folder, partial(capture.run, rig), settings or stages(), Resources())
    return folder


def matrix_rig(matrix: np.ndarray | None = None, noise: Sensor | None = None) -> OperatorRig:
    return OperatorRig(symmetric_matrix() if matrix is None else matrix, SHAPE, SHAPE, noise)


class FaultyRig:
    """A rig whose frames of some patterns come out differently."""

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


def left(path: Path) -> dict[str, bytes]:
    """Bytes of manifests and stores."""
    files = contents(path)
    return {name: files[name] for name in files if not name.endswith((".log", ".tsv"))}


def damage(store: Path) -> Path:
    chunk = max((path for path in store.rglob("c*") if path.is_file()), key=lambda p: p.name)
    content = chunk.read_bytes()
    chunk.write_bytes(content[: len(content) // 2])
    return chunk
