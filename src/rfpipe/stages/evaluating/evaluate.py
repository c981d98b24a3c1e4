"""Stage: all error figures of a run: relit images against ground truth, as tables."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.evaluating.metrics import colour_difference, psnr, relative_rms, unlit_rms
from rfpipe.stages.jobs.progress import Progress
from rfpipe.stages.jobs.workers import Resources
from rfpipe.store import ArrayBundle, open_arrays, read_manifest
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "ERROR_COLUMNS",
    "SPEED_COLUMNS",
    "error_rows",
    "errors_table",
    "run",
    "speed_error_table",
    "write_table",
]

Rows = list[Any]

# Of a run's images in memory: as read, as float64, and as colours.
_COPIES = 6

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


def errors_table(
    relight_manifests: Iterable[Path], resources: Resources | None = None
) -> pd.DataFrame:
    """Return the errors of each run's own transport: scene, method and `ERROR_COLUMNS`.

    A captured scene has none: its truth is unknown.

    Parameters
    ----------
    relight_manifests : iterable of Path
        ``relight.json`` beside ``relight.zarr``.
    resources : Resources, optional
    """
    import pandas as pd

    found = _each(_errors_of, [(path,) for path in relight_manifests], resources)
    rows = [row for of_run in found for row in of_run]
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


def _each(
    errors: Callable[..., Rows], runs: Sequence[tuple[Path, ...]], resources: Resources | None
) -> Iterator[Rows]:
    """Yield the errors of each run, in their order, wherever they are worked out."""
    if not runs:
        return
    absolute = [tuple(path.absolute() for path in paths) for paths in runs]
    # one is opened to know what all are about as large as
    _, images = _opened(absolute[0][0])
    in_hand = _COPIES * images.part("relit", {}).nbytes
    # what is common to all lies where all workers must see it
    folder = Path(os.path.commonpath([paths[0].parent for paths in absolute]))
    with (
        (resources or Resources()).workers(in_hand, folder) as workers,
        Progress("errors", len(runs), unit="run", quick=True) as progress,
    ):
        work = _Errors(errors, tuple(absolute))
        for found in workers.results(work, [(i, i + 1) for i in range(len(runs))]):
            yield found
            progress.advance(1)


@dataclass(frozen=True)
class _Errors:
    """Works out the errors of runs from what lies on the disk; any thread or process may."""

    errors: Callable[..., Rows]
    runs: tuple[tuple[Path, ...], ...]

    def __call__(self, first: int, last: int) -> Rows:
        return [row for paths in self.runs[first:last] for row in self.errors(*paths)]


def _errors_of(path: Path) -> Rows:
    """Return the rows of `errors_table` of a run; none where its truth is unknown."""
    run, images = _opened(path)
    if "truth" not in images.names:
        return []
    errors = error_rows(images.read("relit"), *_truth(run, images))
    return [{"scene": run["scene"], "method": run["method"], **row} for row in errors]


def run(
    relight_manifests: list[Path],
    errors: Path,
    speed_error: Path,
    seconds_per_pattern: float,
    resources: Resources | None = None,
) -> None:
    """Write `errors_table` and `speed_error_table` as CSV; a figure that isn't defined is blank."""
    tables = {
        errors: errors_table(relight_manifests, resources),
        speed_error: speed_error_table(relight_manifests, seconds_per_pattern),
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
