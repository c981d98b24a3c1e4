"""One acquisition: what it costs, and how far relit pictures are from the truth."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from datetime import date
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from numpy.typing import NDArray

import rfpipe
from benchmarks.methods.cases import CAMERAS, Case, path_of
from benchmarks.methods.scenes import KINDS, Stage, stage_of
from rfpipe.errors import RfpipeError
from rfpipe.photometry import Sensor
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import Scene
from rfpipe.stages.evaluate import relative_rms, unlit_rms

__all__ = ["machine", "measure"]

_BLACK = 8  # all-off brackets behind a photograph
_PHOTOGRAPHS = 1000  # key of their noise, which no level has


class CountingRig(SimulatedRig):
    """A simulated rig that counts brackets and the light that was shown.

    Attributes
    ----------
    brackets : int
        Taken so far, all-off and all-on ones included.
    lit : float
        Sum over them of the pattern's mean weight.
    """

    def __init__(self, scene: Scene, sensor: Sensor, seed: int) -> None:
        super().__init__(scene, sensor, seed)
        self.brackets, self.lit = 0, 0.0

    def capture(
        self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]
    ) -> NDArray[Any]:
        """Show patterns and return their brackets."""
        self.brackets += len(patterns)
        self.lit += float(patterns.reshape(len(patterns), -1).mean(axis=1, dtype=float).sum())
        return super().capture(patterns, keys)


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
    result = rfpipe.acquire(rig, path_of(case.method), progress=False, **case.options)
    relit = result.transport.relight_batch(np.stack(list(stage.patterns.values())))
    total, unlit = _errors(stage, relit)
    photo, photo_unlit = _photographed(stage, case.light, case.seed)
    known = len(result.history) > 0
    seconds = sum(camera.exposures)
    light = camera.electrons_per_radiance / CAMERAS["full"].electrons_per_radiance
    return {
        "camera_rays": int(np.prod(rig.camera_shape)),
        "projector_rays": int(np.prod(rig.projector_shape)),
        "patterns": result.patterns,
        "brackets": rig.brackets,
        "exposure_s": rig.brackets * seconds,
        "light_s": rig.lit * seconds * light,
        "error_mean": np.nanmean(total),
        "error_worst": np.nanmax(total),
        "worst_picture": list(stage.patterns)[int(np.nanargmax(total))],
        "unlit_mean": _mean(unlit),
        "unlit_worst": max((x for x in unlit if not np.isnan(x)), default=float("nan")),
        "photo_mean": photo,
        "photo_unlit": photo_unlit,
        "grain": stage.grain,
        "estimated_error": float(result.history["estimated_error"].iloc[-1]) if known else "",
        "patterns_by_estimate": int(result.history["patterns"].iloc[-1]) if known else "",
        "processing_s": result.processing_seconds,
        "stored_mb": result.transport.nbytes / 1e6,
    }


def _errors(stage: Stage, images: NDArray[Any]) -> tuple[list[float], list[float]]:
    """Return each picture's error in total, and where its pattern is dark (coaxial rigs alone)."""
    pairs = list(zip(images, stage.truth, stage.patterns.values(), strict=True))
    total = [relative_rms(image, true) for image, true, _ in pairs]
    dark = [unlit_rms(*each) for each in pairs] if stage.coaxial else [float("nan")] * len(pairs)
    return total, dark


def _mean(errors: list[float]) -> float:
    defined = [error for error in errors if not np.isnan(error)]
    return float(np.mean(defined)) if defined else float("nan")


@lru_cache(maxsize=2)
def _photographed(stage: Stage, light: str, seed: int) -> tuple[float, float]:
    """Return the mean errors of one bracket of each picture itself: what the camera's noise does.

    In total and where patterns are dark.
    """
    sensor = CAMERAS[light]
    dark = np.zeros_like(stage.truth[0])
    keys = [(_PHOTOGRAPHS, index) for index in range(_BLACK + len(stage.truth))]
    off = [sensor.expose(dark, seed, key) for key in keys[:_BLACK]]
    merge = sensor.merging(np.mean(off, axis=0, dtype=np.float32), _BLACK)
    on = [sensor.expose(*each) for each in _with_keys(stage.truth, seed, keys[_BLACK:])]
    total, unlit = _errors(stage, merge(np.stack(on)).radiance)
    return _mean(total), _mean(unlit)


def _with_keys(truth: NDArray[Any], seed: int, keys: list[tuple[int, int]]) -> Any:
    return ((image, seed, key) for image, key in zip(truth, keys, strict=True))
