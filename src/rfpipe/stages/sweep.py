"""Speed against error: the same acquisition at several tolerances, in this process."""

from __future__ import annotations

import csv
import io
import logging
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import versions

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.transport import Transport

__all__ = ["TIMES_COLUMNS", "Sweep", "stored_bytes", "sweep", "sweep_tolerances"]

TIMES_COLUMNS = ("tolerance", "capture_s", "processing_s", "simulation_s")

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sweep:
    """What `sweep_tolerances` found, one entry a tolerance.

    Attributes
    ----------
    relit : ndarray of float32, shape (T, P, H, W, C)
        The reference patterns relit, radiance.
    rows : list of dict
        ``tolerance``, ``patterns`` shown, ``bytes`` stored: the same in every run.
    times : list of dict
        `TIMES_COLUMNS`: seconds that a real rig takes to show the patterns, and wall seconds that
        were measured here, of processing and of simulating the pictures.
    """

    relit: NDArray[np.float32]
    rows: list[dict[str, Any]]
    times: list[dict[str, float]]


def stored_bytes(transport: Transport) -> int:
    """Return the bytes that a transport takes in a store."""
    from rfpipe.transport import open_transport, save_transport

    with TemporaryDirectory(prefix="rfpipe-") as folder:
        path = Path(folder) / "transport.zarr"
        save_transport(transport, path)
        return open_transport(path).nbytes


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
    from rfpipe.scenes.reference import scene_from_config
    from rfpipe.scenes.relighting import relighting_patterns
    from rfpipe.stages.acquire import acquire

    exact = scene_from_config(config.scenes[scene])
    rig = SimulatedRig(
        exact, sensor_from_config(config.camera), config.seed, config.capture.seconds_per_pattern
    )
    patterns = np.stack(list(relighting_patterns(exact.shape).values()))
    relit: list[NDArray[np.float32]] = []
    rows: list[dict[str, Any]] = []
    times: list[dict[str, float]] = []
    for tolerance in config.report.tolerances:
        result = acquire(
            rig,
            method,
            tolerance,
            progress=False,
            noise_significance=config.acquisition.noise_significance,
            normalization=config.normalization,
            black_frames=config.capture.black_frames,
            repair_defects=config.merge.repair_defects,
            saturation_fraction=config.merge.saturation_fraction,
        )
        relit.append(result.transport.relight_batch(patterns))
        row = {
            "tolerance": tolerance,
            "patterns": result.patterns,
            "bytes": stored_bytes(result.transport),
        }
        rows.append(row)
        times.append(
            {
                "tolerance": tolerance,
                "capture_s": result.patterns * rig.seconds_per_pattern,
                "processing_s": result.processing_seconds,
                "simulation_s": result.capture_seconds,
            }
        )
        _log.info("%s, %s at tolerance %g: %s", scene, method, tolerance, row)
    return Sweep(np.stack(relit), rows, times)


def sweep(
    config: Config, scene: str, method: str, store: Path, times: Path, manifest: Path,
    *, fingerprint: str,
) -> None:  # fmt: skip
    """Run `sweep_tolerances` and write its images, its times and a manifest.

    Parameters
    ----------
    config : Config
    scene, method : str
    store : Path
        Bundle of arrays to write: ``relit``.
    times : Path
        CSV table of `TIMES_COLUMNS`. It stands apart since it differs from run to run.
    manifest : Path
        Written last.
    fingerprint : str
        Of the settings and the code that shape the result.
    """
    from rfpipe.store.arrays import write_arrays
    from rfpipe.store.files import write_atomically
    from rfpipe.store.manifest import write_manifest

    found = sweep_tolerances(config, scene, method)
    attributes = {"scene": scene, "method": method, "units": "radiance"}
    digest = write_arrays(store, {"relit": found.relit}, attributes)
    text = io.StringIO()
    writer = csv.DictWriter(text, TIMES_COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(found.times)
    write_atomically(times, text.getvalue().encode())
    write_manifest(
        manifest,
        {
            **attributes,
            "digest": digest,
            "fingerprint": fingerprint,
            "rows": found.rows,
            "versions": versions(),
        },
    )
