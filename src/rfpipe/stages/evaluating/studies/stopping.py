"""Acquisitions on files that are stopped, damaged or started twice."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import RfpipeError, StoreError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes.reference import reference_scene
from rfpipe.stages import acquisition, capture
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.plan import Plan
from rfpipe.store import StoreLock
from rfpipe.transport import open_transport
from rfpipe.units import SATURATION_FRACTION

__all__ = ["acquire_stopping", "cases"]

_SHAPE = (8, 8)
_STOP_AT = (2, 1)  # the pattern before which an acquisition is stopped
_METHOD = "symmetric"
_FULL_BYTES = 2_000  # that a file may have on a full disk
_SIGNALS = {"Ctrl-C": signal.SIGINT, "SIGTERM": signal.SIGTERM, "kill -9": signal.SIGKILL}
_FULL_DISK = "full disk"


class _StoppedRig(SimulatedRig):
    """A rig that counts its patterns, and before one stops its process or fills its disk."""

    def __init__(self, stop: str = "") -> None:
        super().__init__(reference_scene("IV", _SHAPE, channels=1))
        self.shown = 0
        self._stop = stop

    def capture(
        self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]
    ) -> NDArray[Any]:
        """Show patterns, as `SimulatedRig` does."""
        if self._stop and _STOP_AT in map(tuple, keys):
            if self._stop == _FULL_DISK:
                resource.setrlimit(resource.RLIMIT_FSIZE, (_FULL_BYTES, _FULL_BYTES))
            else:
                os.kill(os.getpid(), _SIGNALS[self._stop])
        self.shown += len(patterns)
        return super().capture(patterns, keys)


def _acquire(path: Path, stop: str = "") -> int:
    """Do what the workflow's job does; return how many patterns were shown."""
    rig = _StoppedRig(stop)
    folder = AcquisitionFolder(path)
    with StoreLock(path):
        acquisition.run(
            Plan(_METHOD, _METHOD, _SHAPE, _SHAPE, 1),
            folder,
            partial(capture.run, rig),
            {
                "schedule": {"code": ""},
                "capture": {"references": (2, 2), "batch_patterns": 1},
                "merge": {
                    "saturation_fraction": SATURATION_FRACTION, "mask_defects": True, "code": "",
                },
                "normalize": {"mode": "per_channel", "code": ""},
                "refine": {"code": ""},
                "assemble": {"scene": "scene IV", "number_format": "float32", "code": ""},
            },
            Resources(),
        )  # fmt: skip
    return rig.shown


def acquire_stopping(path: str, stop: str) -> None:
    """Acquire into a folder in a process of its own, until something stops it.

    Parameters
    ----------
    path : str
    stop : str
        "Ctrl-C", "SIGTERM", "kill -9" or "full disk".
    """
    try:
        _acquire(Path(path), stop)
    except RfpipeError as error:
        sys.exit(str(error))


def cases(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield what is done to an acquisition on files, and what happened.

    Parameters
    ----------
    folder : Path
        Empty, to work in.
    """
    whole = folder / "whole"
    patterns = _acquire(whole)
    for stop in (*_SIGNALS, _FULL_DISK):
        yield stop, _stopped(folder / "stopped", stop, whole, patterns)
        shutil.rmtree(folder / "stopped")
    with StoreLock(whole):
        try:
            _acquire(whole)
        except RfpipeError as error:
            yield "two runs in one folder", f"refused: {_named(error, folder)}"
    for case, damage in (
        ("truncated chunk", lambda chunk: chunk.write_bytes(chunk.read_bytes()[:-8])),
        ("altered chunk", _alter),
        ("missing chunk", Path.unlink),
    ):
        spoilt = folder / "spoilt"
        shutil.copytree(whole, spoilt)
        store = spoilt / "transport.zarr"
        damage(max(store.rglob("c.*"), key=lambda path: path.stat().st_size))
        try:
            open_transport(store).relight(np.ones(_SHAPE, np.float32))
        except StoreError as error:
            yield case, f"refused: {_named(error, folder)}"
        else:
            yield case, "read without a word"
        shutil.rmtree(spoilt)


def _stopped(path: Path, stop: str, whole: Path, patterns: int) -> str:
    """Stop an acquisition, go on with it, and say what came of it."""
    code = (
        "from rfpipe.stages.evaluating.studies.stopping import acquire_stopping as go; "
        f"go({str(path)!r}, {stop!r})"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], stdin=subprocess.DEVNULL, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    kept = patterns - _acquire(path)
    same = _contents(path) == _contents(whole)
    how = "refused to go on" if ended.returncode == 1 else "stopped"
    told = (
        f"{how}; the next run kept {kept} of {patterns} brackets and ended with "
        f"{'the same' if same else 'other'} bytes as an undisturbed one"
    )
    return told if ended.returncode else "was not stopped"


def _contents(path: Path) -> dict[str, bytes]:
    """Return all that an acquisition leaves but logs and times."""
    files = (each for each in path.rglob("*") if each.is_file())
    return {
        str(each.relative_to(path)): each.read_bytes()
        for each in files
        if each.suffix not in (".log", ".tsv", ".lock")
    }


def _alter(chunk: Path) -> None:
    """Change a byte of a file."""
    data = bytearray(chunk.read_bytes())
    data[len(data) // 2] ^= 1
    chunk.write_bytes(data)


def _named(error: Exception, folder: Path) -> str:
    """Return what an error says, on one line and without where and as what the study runs."""
    told = str(error).replace(f"{folder}/", "").replace(f"process {os.getpid()}", "a process")
    return " ".join(told.split())
