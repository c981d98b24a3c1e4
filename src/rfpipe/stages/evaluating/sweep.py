"""Stage: speed against error: the same acquisition at several tolerances, in this process."""

from __future__ import annotations

import csv
import io
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import fingerprint
from rfpipe.stages.results import accept_bundle, write_bundle
from rfpipe.stages.settings import acquire_options
from rfpipe.store.files import write_atomically
from rfpipe.units import RADIANCE_UNIT, NumberFormat

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.transport import Transport

__all__ = ["TIMES_COLUMNS", "Sweep", "run", "stored", "sweep_tolerances"]

TIMES_COLUMNS = ("tolerance", "processing_s", "simulation_s")
"""Wall seconds measured here, of processing and of simulating the pictures."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sweep:
    """What `sweep_tolerances` found, one entry a tolerance.

    Attributes
    ----------
    relit : ndarray of float32, shape (T, P, *shape, C)
        The reference patterns relit, radiance.
    rows : list of dict
        ``tolerance``, ``patterns`` shown, ``bytes`` stored: the same in every run.
    times : list of dict
        `TIMES_COLUMNS`.
    """

    relit: NDArray[np.float32]
    rows: list[dict[str, Any]]
    times: list[dict[str, float]]


@contextmanager
def stored(transport: Transport, number_format: NumberFormat) -> Iterator[Transport]:
    """Store a transport for a while, and open it: its bytes and numbers are those of a run."""
    from rfpipe.transport import open_transport, save_transport

    with TemporaryDirectory(prefix="rfpipe-") as folder:
        path = Path(folder) / "transport.zarr"
        save_transport(transport, path, number_format)
        yield open_transport(path)


def sweep_tolerances(config: Config, scene: str, method: str) -> Sweep:
    """Acquire one scene with one method at each of ``report.tolerances``.

    Parameters
    ----------
    config : Config
    scene, method : str
        A name in ``config.scenes``; one of the methods.

    Returns
    -------
    Sweep
    """
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config, scene_patterns
    from rfpipe.stages.acquire import acquire

    exact = scene_from_config(config.scenes[scene], compress=True)
    rig = SimulatedRig(exact, sensor_from_config(config.camera), config.seed)
    _warm_up(method)
    patterns = np.stack(list(scene_patterns(exact).values()))
    relit: list[NDArray[np.float32]] = []
    rows: list[dict[str, Any]] = []
    times: list[dict[str, float]] = []
    for tolerance in config.report.tolerances:
        result = acquire(rig, method, tolerance, progress=False, **acquire_options(config))
        with stored(result.transport, config.storage.number_format) as transport:
            relit.append(transport.relight_batch(patterns))
            nbytes = transport.nbytes
        row = {"tolerance": tolerance, "patterns": result.patterns, "bytes": nbytes}
        rows.append(row)
        seconds = (tolerance, result.processing_seconds, result.capture_seconds)
        times.append(dict(zip(TIMES_COLUMNS, seconds, strict=True)))
        _log.info("%s, %s at tolerance %g: %s", scene, method, tolerance, row)
    return Sweep(np.stack(relit), rows, times)


def _warm_up(method: str) -> None:
    """Load the compiled kernels, so that no tolerance's time includes it."""
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import reference_scene
    from rfpipe.stages.acquire import acquire

    tiny = reference_scene("IV", (8, 8))
    acquire(SimulatedRig(tiny), method, progress=False).transport.relight(np.ones(tiny.shape))


def run(config: Config, scene: str, method: str, folder: Path, code: str) -> None:
    """Run `sweep_tolerances`; write ``sweep.zarr``, ``sweep.csv`` and ``sweep.json``.

    The CSV table holds the times, which differ from run to run; the rest doesn't.

    Parameters
    ----------
    config : Config
    scene, method : str
    folder : Path
        ``results/{scene}/{method}``.
    code : str
        Fingerprint of the code behind the stage.
    """
    store, times, manifest = (folder / f"sweep.{suffix}" for suffix in ("zarr", "csv", "json"))
    made_from = fingerprint(
        {
            "method": method,
            "scene": config.scenes[scene],
            "camera": config.camera,
            "seed": config.seed,
            "tolerances": config.report.tolerances,
            "acquisition": acquire_options(config),
            "storage": config.storage,
            "code": code,
        }
    )
    if times.exists() and accept_bundle(store, manifest, made_from):
        return
    found = sweep_tolerances(config, scene, method)
    text = io.StringIO()
    writer = csv.DictWriter(text, TIMES_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(found.times)
    write_atomically(times, text.getvalue().encode())
    facts = {
        "stage": "sweep",
        "scene": scene,
        "method": method,
        "rows": found.rows,
        "units": RADIANCE_UNIT,
    }
    write_bundle(store, manifest, made_from, {"relit": found.relit}, facts)
