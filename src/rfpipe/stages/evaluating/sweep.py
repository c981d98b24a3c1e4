"""Stage: speed against error: the same acquisition with other options, in this process."""

from __future__ import annotations

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
from rfpipe.stages.results import write_bundle
from rfpipe.stages.settings import acquire_options
from rfpipe.store import write_manifest
from rfpipe.store.files import digest_of, write_atomically
from rfpipe.units import RADIANCE_UNIT, NumberFormat

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.config.base import MethodSettings
    from rfpipe.transport import Transport

__all__ = ["TIMES_COLUMNS", "Sweep", "is_swept", "run", "stored", "sweep_option", "trials"]

TIMES_COLUMNS = ("value", "processing_s", "simulation_s")
"""Wall seconds measured here, of processing and of simulating the pictures."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sweep:
    """What `sweep_option` found, one entry a value of the option.

    Attributes
    ----------
    relit : ndarray of float32, shape (T, P, *shape, C)
        The reference patterns relit, radiance.
    rows : list of dict
        ``option`` and its ``value``, ``patterns`` shown, ``bytes`` stored: the same in every run.
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


def sweep_option(config: Config, scene: str, method: str) -> Sweep:
    """Acquire one scene with one method at several values of the option that trades patterns.

    Parameters
    ----------
    config : Config
    scene, method : str
        A name in ``config.scenes``; one of its methods, with an option by which it ``trades``.

    Returns
    -------
    Sweep
    """
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config, scene_patterns
    from rfpipe.stages.acquire import acquire

    exact = scene_from_config(config.scenes[scene], many_patterns=True)
    rig = SimulatedRig(exact, sensor_from_config(config.camera), config.seed)
    section = config.methods_of(scene)[method]
    option, values = trials(config, method, section)
    asked = acquire_options(config, method, section)
    _warm_up(asked["method"])
    patterns = np.stack(list(scene_patterns(exact).values()))
    relit: list[NDArray[np.float32]] = []
    rows: list[dict[str, Any]] = []
    times: list[dict[str, float]] = []
    for value in values:
        result = acquire(rig, progress=False, **{**asked, option: value})
        with stored(result.transport, config.storage.number_format) as transport:
            relit.append(transport.relight_batch(patterns))
            nbytes = transport.nbytes
        row = {"option": option, "value": value, "patterns": result.patterns, "bytes": nbytes}
        rows.append(row)
        seconds = (value, result.processing_seconds, result.capture_seconds)
        times.append(dict(zip(TIMES_COLUMNS, seconds, strict=True)))
        _log.info("%s, %s: %s", scene, method, row)
    return Sweep(np.stack(relit), rows, times)


def is_swept(config: Config, scene: str, method: str) -> bool:
    """Tell whether a method is to acquire a scene again with other options."""
    section = config.methods_of(scene)[method]
    wanted = config.scenes[scene].is_swept and section.subject(method).trades is not None
    return wanted and bool(trials(config, method, section)[1])


def trials(config: Config, name: str, section: MethodSettings) -> tuple[str, tuple[float, ...]]:
    """Return the option by which a method trades patterns for accuracy, and its values to try.

    A whole number stays one: numbers of patterns are.
    """
    method = section.subject(name)
    whole = isinstance(section.options()[method.trades], int)
    values = config.report.trials.get(name, method.trials)
    return method.trades, tuple(round(value) if whole else value for value in values)


def _warm_up(method: str) -> None:
    """Load the compiled kernels, so that no acquisition's time includes it."""
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import reference_scene
    from rfpipe.stages.acquire import acquire

    tiny = reference_scene("IV", (8, 8))
    acquire(SimulatedRig(tiny), method, progress=False).transport.relight(np.ones(tiny.shape))


def run(config: Config, scene: str, method: str, folder: Path, code: str) -> None:
    """Run `sweep_option`; write ``sweep.zarr``, ``sweep.csv`` and ``sweep.json``.

    The CSV table holds the times, which differ from run to run; the rest doesn't.

    Parameters
    ----------
    config : Config
    scene, method : str
    folder : Path
        ``results/{scene}/{method}``.
    code : str
        Digest of the code behind the stage.
    """
    import pandas as pd

    times, manifest = folder / "sweep.csv", folder / "sweep.json"
    section = config.methods_of(scene)[method]
    made_from = fingerprint(
        {
            "method": method,
            "scene": config.scenes[scene],
            "camera": config.camera,
            "seed": config.seed,
            "trials": trials(config, method, section),
            "acquisition": acquire_options(config, method, section),
            "storage": config.storage,
            "code": code,
        }
    )
    found = sweep_option(config, scene, method)
    table = pd.DataFrame(found.times).to_csv(index=False, lineterminator="\n").encode()
    write_atomically(times, table)
    # apart from the sweep's manifest, which is the same in every run
    write_manifest(folder / "sweep_times.json", {"table": times.name, "times": digest_of(table)})
    about = {"stage": "sweep", "scene": scene, "method": method}
    facts = {**about, "rows": found.rows, "units": RADIANCE_UNIT}
    write_bundle(manifest, made_from, {"relit": found.relit}, facts)
