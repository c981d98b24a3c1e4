"""Stage: speed against error: the same acquisition with other options, in this process."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.provenance import fingerprint
from rfpipe.stages.results import standing, write_bundle
from rfpipe.stages.settings import acquire_options
from rfpipe.store import open_arrays, read_manifest, write_manifest
from rfpipe.store.files import digest_of, remove_tree, write_atomically
from rfpipe.units import RADIANCE_UNIT, NumberFormat

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.config.base import MethodSettings
    from rfpipe.transport import Transport

__all__ = ["TIMES_COLUMNS", "is_swept", "run", "stored", "trials"]

TIMES_COLUMNS = ("value", "processing_s", "simulation_s")
"""Wall seconds measured here, of processing and of simulating the pictures."""

_log = logging.getLogger(__name__)


@contextmanager
def stored(transport: Transport, number_format: NumberFormat) -> Iterator[Transport]:
    """Store a transport for a while, and open it: its bytes and numbers are those of a run."""
    from rfpipe.transport import open_transport, save_transport

    with TemporaryDirectory(prefix="rfpipe-") as folder:
        path = Path(folder) / "transport.zarr"
        save_transport(transport, path, number_format)
        yield open_transport(path)


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
    """Acquire a scene with a method at several values of the option that trades patterns.

    Writes ``sweep.zarr``, ``sweep.csv`` and ``sweep.json``: the reference patterns relit at each
    value, and its patterns and bytes. The CSV table holds the times, `TIMES_COLUMNS`, which differ
    from run to run; the rest doesn't. Until all are there, each value's point is kept apart, so
    that a sweep that was stopped goes on at the next.

    Parameters
    ----------
    config : Config
    scene, method : str
        A name in ``config.scenes``; one of its methods, with an option by which it ``trades``.
    folder : Path
        ``results/{scene}/{method}``.
    code : str
        Digest of the code behind the stage.
    """
    times, manifest, kept = (folder / name for name in ("sweep.csv", "sweep.json", "sweep_points"))
    section = config.methods_of(scene)[method]
    option, values = trials(config, method, section)
    made_from = {
        "method": method,
        "scene": config.scenes[scene],
        "camera": config.camera,
        "seed": config.seed,
        "acquisition": acquire_options(config, method, section),
        "storage": config.storage,
        "code": code,
    }
    whole = fingerprint({**made_from, "trials": (option, values)})
    points = {
        kept / f"{value}.json": (value, fingerprint({**made_from, option: value}))
        for value in values
    }
    missing = {point: made for point, made in points.items() if not standing(point, made[1])}
    if missing:
        _acquire(config, scene, method, missing)
    _put_together(list(points), times, manifest, whole, {"scene": scene, "method": method})
    remove_tree(kept)


def _acquire(
    config: Config, scene: str, method: str, points: dict[Path, tuple[float, str]]
) -> None:
    """Acquire a scene at some values; write a bundle for each, by its manifest and fingerprint."""
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config, scene_patterns
    from rfpipe.stages.acquire import acquire

    exact = scene_from_config(config.scenes[scene], many_patterns=True)
    rig = SimulatedRig(exact, sensor_from_config(config.camera), config.seed)
    section = config.methods_of(scene)[method]
    option, _ = trials(config, method, section)
    asked = acquire_options(config, method, section)
    _warm_up(asked["method"])
    patterns = np.stack(list(scene_patterns(exact).values()))
    for point, (value, made_from) in points.items():
        result = acquire(rig, progress=False, **{**asked, option: value})
        with stored(result.transport, config.storage.number_format) as transport:
            relit, nbytes = transport.relight_batch(patterns), transport.nbytes
        row = {"option": option, "value": value, "patterns": result.patterns, "bytes": nbytes}
        seconds = (value, result.processing_seconds, result.capture_seconds)
        took = dict(zip(TIMES_COLUMNS, seconds, strict=True))
        facts = {"stage": "sweep", "row": row, "seconds": took, "units": RADIANCE_UNIT}
        write_bundle(point, made_from, {"relit": relit}, facts)
        _log.info("%s, %s: %s", scene, method, row)


def _put_together(
    points: list[Path], times: Path, manifest: Path, made_from: str, about: dict[str, str]
) -> None:
    """Write the sweep of all points, and their table of times."""
    import pandas as pd

    facts = [read_manifest(point) for point in points]
    rows = [each["seconds"] for each in facts]
    table = pd.DataFrame(rows).to_csv(index=False, lineterminator="\n").encode()
    write_atomically(times, table)
    # apart from the sweep's manifest, which is the same in every run
    write_manifest(
        times.with_name("sweep_times.json"), {"table": times.name, "times": digest_of(table)}
    )
    relit = np.stack([open_arrays(point.with_suffix(".zarr")).read("relit") for point in points])
    found = {"stage": "sweep", **about, "rows": [each["row"] for each in facts]}
    write_bundle(manifest, made_from, {"relit": relit}, {**found, "units": RADIANCE_UNIT})
