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
        facts, images = _opened(path)
        if "truth" in images.names:
            errors = error_rows(images.read("relit"), *_truth(facts, images))
            rows += [{"scene": facts["scene"], "method": facts["method"], **row} for row in errors]
    return pd.DataFrame(rows, columns=["scene", "method", *ERROR_COLUMNS])


SPEED_COLUMNS = ("scene", "method", "level", "patterns", "capture_s", "error")
"""Patterns and seconds of capture up to a level; relative RMS error in total of the first
relighting pattern's image, by the transport as of then."""


def speed_error_table(
    relight_manifests: Iterable[Path], seconds_per_pattern: float
) -> pd.DataFrame:
    """Return cost and error of each run after each level that it knows: `SPEED_COLUMNS`.

    Parameters
    ----------
    relight_manifests : iterable of Path
    seconds_per_pattern : float
        Of a real rig.
    """
    import pandas as pd

    rows = []
    for path in relight_manifests:
        run, images = _opened(path)
        if "truth" not in images.names:
            continue
        truth, relit = images.read("truth")[0], images.read("levels_relit")
        levels = run["levels"][-len(relit) :]
        shown = np.cumsum([row["patterns"] for row in run["levels"]])[-len(relit) :]
        for row, patterns, image in zip(levels, shown, relit, strict=True):
            if not row["patterns"] and len(relit) > 1:
                continue
            about = (run["scene"], run["method"], row["level"], int(patterns))
            rows.append((*about, patterns * seconds_per_pattern, relative_rms(image, truth)))
    return pd.DataFrame(rows, columns=list(SPEED_COLUMNS))


def run(
    relight_manifests: list[Path], errors: Path, speed_error: Path, seconds_per_pattern: float
) -> None:
    """Write `errors_table` and `speed_error_table` as CSV; a figure that isn't defined is blank."""
    write_table(errors, errors_table(relight_manifests))
    write_table(speed_error, speed_error_table(relight_manifests, seconds_per_pattern))


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a table of numbers as CSV, to six digits."""
    text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(path, text.encode())


def _opened(manifest: Path) -> tuple[dict[str, Any], ArrayBundle]:
    return read_manifest(manifest), open_arrays(manifest.with_suffix(".zarr"))


def _truth(facts: dict[str, Any], images: ArrayBundle) -> tuple[Any, Any, list[str], float, bool]:
    """Return the arguments of `error_rows` after the relit images."""
    white = float(images.read("floodlit_truth").max(initial=0.0))
    return images.read("truth"), images.read("patterns"), facts["names"], white, facts["coaxial"]
