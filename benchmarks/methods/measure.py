"""One acquisition: its cost, and the errors of relit pictures."""

from __future__ import annotations

import ctypes
import gc
import os
import platform
from collections.abc import Sequence
from datetime import date
from functools import lru_cache
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

import rfpipe
from benchmarks.methods.cases import CAMERAS, Case, path_of
from benchmarks.methods.scenes import KINDS, Stage, stage_of
from rfpipe.errors import RfpipeError
from rfpipe.photometry import Sensor
from rfpipe.relighting import KINDS as PICTURES
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import Scene

__all__ = ["machine", "measure"]

_BLACK = 8  # all-off brackets behind a photograph
_PHOTOGRAPHS = 1000  # key of their noise, which no level has
_PHOTOGRAPHED = 24  # pictures, the first ones


class CountingRig(SimulatedRig):
    """A simulated rig that counts pictures and the light that was shown.

    Attributes
    ----------
    pictures : int
        Brackets taken so far, whatever for.
    lit : float
        Sum over them of the pattern's mean weight.
    processor_seconds : float
        Processor time of their simulation.
    """

    def __init__(self, scene: Scene, sensor: Sensor, seed: int) -> None:
        super().__init__(scene, sensor, seed)
        self.pictures, self.lit, self.processor_seconds = 0, 0.0, 0.0

    def capture(
        self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]
    ) -> NDArray[Any]:
        """Show patterns and return their brackets."""
        self.pictures += len(patterns)
        self.lit += float(patterns.reshape(len(patterns), -1).mean(axis=1, dtype=float).sum())
        began = process_time()
        brackets = super().capture(patterns, keys)
        self.processor_seconds += process_time() - began
        return brackets


def machine() -> str:
    """Say what this machine is, without its name."""
    memory = round(psutil.virtual_memory().total / 2**30)
    return f"{platform.machine()}, {os.cpu_count()} cores, {memory} GiB"


def measure(case: Case, cache: Path) -> dict[str, object]:
    """Acquire, relight and compare; a method that refuses or fails makes a row that says so.

    Parameters
    ----------
    case : Case
    cache : Path
        Folder of recorded matrices.

    Returns
    -------
    dict
        By the names of the table's columns.
    """
    row: dict[str, object] = {
        "key": case.key,
        **vars(case),
        **case.held_out,
        "what": KINDS[case.scene].what,
        "date": date.today().isoformat(),
        "machine": machine(),
        "code": case.code,
    }
    try:
        return row | _measured(case, cache) | {"status": "done"}
    except RfpipeError as error:
        return row | {"status": "refused", "why": " ".join(str(error).split())}
    except Exception as error:
        return row | {"status": "failed", "why": f"{type(error).__name__}: {error}"}


def _measured(case: Case, cache: Path) -> dict[str, object]:
    stage = stage_of(case.scene, case.side, case.channels, case.samples, case.seed, cache)
    camera = CAMERAS[case.light]
    rig = CountingRig(stage.scene, camera, case.seed)
    before, began = _memory_before(), process_time()
    result = rfpipe.acquire(rig, path_of(case.method), progress=False, **case.options)
    processing = process_time() - began - rig.processor_seconds
    memory = _peak_memory() - before
    total, indirect = stage.errors(result.transport.relight_batch(stage.patterns))
    photo, photo_indirect = _photographed(stage, case.light, case.seed)
    estimated = result.history.iloc[-1] if len(result.history) else {}
    seconds = sum(camera.exposures)
    light = camera.electrons_per_radiance / CAMERAS["full"].electrons_per_radiance
    of_kind = [np.mean(total[at :: len(PICTURES)]) for at in range(len(PICTURES))]
    return {
        "camera_rays": int(np.prod(rig.camera_shape)),
        "projector_rays": int(np.prod(rig.projector_shape)),
        "patterns": result.patterns,
        "pictures": rig.pictures,
        "exposure_s": rig.pictures * seconds,
        "light_s": rig.lit * seconds * light,
        "error_mean": np.mean(total),
        **{f"error_{kind}": mean for kind, mean in zip(PICTURES, of_kind, strict=True)},
        "error_worst": np.max(total),
        "indirect_mean": np.mean(indirect),
        "photo_mean": photo,
        "photo_indirect": photo_indirect,
        "grain": stage.grain,
        "estimated_error": estimated.get("estimated_error", ""),
        "estimated_indirect": estimated.get("estimated_indirect", ""),
        "processing_s": processing,
        "memory_gb": memory / 1e9,
        "stored_mb": result.transport.nbytes / 1e6,
    }


def _memory_before() -> float:
    """Return the bytes in memory, and forget their peak; NaN where the system can't."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)  # freed memory, which would otherwise be reused unnoticed
        Path("/proc/self/clear_refs").write_text("5")  # Linux: the peak
    except (AttributeError, OSError, TypeError):
        return float("nan")
    return float(psutil.Process().memory_info().rss)


def _peak_memory() -> float:
    """Return the most bytes in memory since `_memory_before`; NaN where the system can't."""
    status = Path("/proc/self/status")
    _, _, peak = (status.read_text() if status.exists() else "").partition("VmHWM:")
    return 1024 * float(peak.split()[0]) if peak else float("nan")


@lru_cache(maxsize=2)
def _photographed(stage: Stage, light: str, seed: int) -> tuple[float, float]:
    """Return the mean errors of one bracket of a picture itself: what the camera's noise does.

    In total and of indirect light.
    """
    sensor = CAMERAS[light]
    pictures = stage.truth[:_PHOTOGRAPHED]
    dark = np.zeros_like(pictures[0])
    keys = [(_PHOTOGRAPHS, index) for index in range(_BLACK + len(pictures))]
    off = [sensor.expose(dark, seed, key) for key in keys[:_BLACK]]
    merge = sensor.bracket_merge(np.mean(off, axis=0, dtype=np.float32), _BLACK)
    on = [
        sensor.expose(image, seed, key) for image, key in zip(pictures, keys[_BLACK:], strict=True)
    ]
    total, indirect = stage.errors(merge(np.stack(on)).radiance)
    return float(np.mean(total)), float(np.mean(indirect))
