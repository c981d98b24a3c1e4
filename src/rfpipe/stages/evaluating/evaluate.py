"""Stage: all error figures of a run: relit images against ground truth, as tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.evaluating.metrics import colour_difference, psnr, relative_rms, unlit_rms
from rfpipe.store import ArrayBundle, open_arrays, read_manifest
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["ERROR_COLUMNS", "error_rows", "errors_table", "run", "speed_error_table", "write_table"]

ERROR_COLUMNS = ("pattern", "rms_total", "rms_unlit", "psnr_db", "ciede2000")
"""Relighting pattern; relative RMS error in total and on the pixels that it leaves dark; PSNR in
dB, its peak the truth's maximum; mean CIEDE2000, with the true floodlit image's maximum as
white."""


def error_rows(
    relit: NDArray[Any],
    truth: NDArray[Any],
    patterns: NDArray[Any],
    names: Iterable[str],
    white: float,
    is_coaxial: bool = True,
) -> Iterator[dict[str, Any]]:
    """Yield a row of `ERROR_COLUMNS` for each relighting pattern.

    Parameters
    ----------
    relit, truth : ndarray of float, shape (P, *camera_shape, C)
        Radiance over a ray domain.
    patterns : ndarray, shape (P, *projector_shape)
    names : iterable of P str
    white : float
        Maximum of the true floodlit image.
    is_coaxial : bool
        Whether camera and projector share their rays; otherwise no pixel is known to be unlit.
    """
    for name, image, true, pattern in zip(names, relit, truth, patterns, strict=True):
        yield {
            "pattern": name,
            "rms_total": relative_rms(image, true),
            "rms_unlit": unlit_rms(image, true, pattern) if is_coaxial else float("nan"),
            "psnr_db": psnr(image, true),
            "ciede2000": colour_difference(image, true, white),
        }


def errors_table(relight_manifests: Iterable[Path]) -> pd.DataFrame:
    """Return the errors of each run's own transport: scene, method and `ERROR_COLUMNS`.

    A captured scene has none: its truth is unknown.

    Parameters
    ----------
    relight_manifests : iterable of Path
        ``relight.json`` beside ``relight.zarr``.
    """
    import pandas as pd

    rows = []
    for path in relight_manifests:
        run, images = _opened(path)
        if "truth" not in images.names:
            continue
        errors = error_rows(images.read("relit"), *_truth(run, images))
        rows += [{"scene": run["scene"], "method": run["method"], **row} for row in errors]
    return pd.DataFrame(rows, columns=["scene", "method", *ERROR_COLUMNS])


def speed_error_table(
    relight_manifests: Iterable[Path],
    sweep_manifests: Iterable[Path],
    seconds_per_pattern: float,
) -> pd.DataFrame:
    """Return cost and errors at every value of the sweeps.

    Parameters
    ----------
    relight_manifests, sweep_manifests : iterable of Path
        ``relight.json`` and ``sweep.json`` of each run; stores and ``sweep.csv`` lie beside them.
    seconds_per_pattern : float
        Of a real rig.

    Returns
    -------
    DataFrame
        A row for each scene, method, value of its option and relighting pattern: ``patterns``
        shown, ``capture_s`` at the rig's stated seconds a pattern, ``processing_s`` and
        ``simulation_s`` as measured, ``bytes`` stored, and `ERROR_COLUMNS`.
    """
    import pandas as pd

    truths = {}
    for path in relight_manifests:
        run, images = _opened(path)
        if "truth" in images.names:
            truths[run["scene"]] = _truth(run, images)
    columns = ["scene", "method", "option", "value", "patterns", "capture_s"]
    columns += ["processing_s", "simulation_s", "bytes", *ERROR_COLUMNS]
    rows = []
    for path in sweep_manifests:
        run, images = _opened(path)
        times = pd.read_csv(path.with_suffix(".csv")).to_dict("records")
        for relit, cost, seconds in zip(images.read("relit"), run["rows"], times, strict=True):
            for row in error_rows(relit, *truths[run["scene"]]):
                capture = {"capture_s": cost["patterns"] * seconds_per_pattern}
                names = {"scene": run["scene"], "method": run["method"]}
                rows.append({**names, **cost, **seconds, **capture, **row})
    return pd.DataFrame(rows, columns=columns)


def run(
    relight_manifests: list[Path],
    sweep_manifests: list[Path],
    errors: Path,
    speed_error: Path,
    seconds_per_pattern: float,
) -> None:
    """Write `errors_table` and `speed_error_table` as CSV; a figure that isn't defined is blank."""
    tables = {
        errors: errors_table(relight_manifests),
        speed_error: speed_error_table(relight_manifests, sweep_manifests, seconds_per_pattern),
    }
    for path, table in tables.items():
        write_table(path, table)


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a table of numbers as CSV, to six digits."""
    text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(path, text.encode())


def _opened(manifest: Path) -> tuple[dict[str, Any], ArrayBundle]:
    return read_manifest(manifest), open_arrays(manifest.with_suffix(".zarr"))


def _truth(
    run: dict[str, Any], images: ArrayBundle
) -> tuple[NDArray[np.float32], NDArray[np.float32], list[str], float, bool]:
    """Return what `error_rows` wants of a scene beside the relit images."""
    white = float(images.read("floodlit_truth").max(initial=0.0))
    return images.read("truth"), images.read("patterns"), run["names"], white, run["coaxial"]
