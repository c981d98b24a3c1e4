"""Stage: tables of the errors of relit pictures of all acquisitions of a run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.relighting import picture_squared_norms
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.store import ArrayBundle, open_arrays, read_manifest
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd

Image = NDArray[Any]

_NAMES = ["scene", "method"]


def run(
    relight_manifests: list[Path], errors: Path, speed_error: Path, seconds_per_pattern: float
) -> None:
    """Write `errors_table` and `speed_error_table` as CSV; undefined numbers are blank."""
    write_table(errors, errors_table(relight_manifests))
    write_table(speed_error, speed_error_table(relight_manifests, seconds_per_pattern))


def errors_table(relight_manifests: Iterable[Path]) -> pd.DataFrame:
    """Return the errors of relit pictures, from ``relight.json`` of scenes with a known truth.

    Returns
    -------
    pandas.DataFrame
        A row for each reference pattern and each kind of pictures, with means over the kind:
        ``scene``, ``method``, ``pattern``; ``error`` and ``indirect_error`` (of indirect light),
        see `picture_errors`; ``plain_error``, relative to the picture's norm, however dark it is.
        ``ciede2000``, the mean over pixels, for the patterns only; white is the maximum of the true
        floodlit image.
    """
    import pandas as pd

    columns = [*_NAMES, "pattern", "error", "plain_error", "indirect_error", "ciede2000"]
    rows: list[list[Any]] = []
    for facts, images in _with_truth(relight_manifests):
        names, nan = [facts[key] for key in _NAMES], float("nan")
        plain, indirect = (facts.get(f"{name}_errors", {}) for name in ("plain", "indirect"))
        rows += [
            [*names, kind, error, plain.get(kind, nan), indirect.get(kind, nan), nan]
            for kind, error in facts["errors"].items()
        ]
        rows += [[*names, *row] for row in _pattern_rows(facts, images)]
    return pd.DataFrame(rows, columns=columns)


def _pattern_rows(facts: dict[str, Any], images: ArrayBundle) -> Iterator[list[Any]]:
    """Yield name and errors of the relit picture of each reference pattern."""
    floodlit = images.read("floodlit_truth")
    relit, truth, patterns = (images.read(name) for name in ("relit", "truth", "patterns"))
    # without a coaxial rig, pixels without direct light are unknown
    dark = patterns == 0 if facts["coaxial"] else None
    total, unlit = picture_squared_norms(relit, truth, patterns, floodlit, dark)
    white = float(floodlit.max(initial=0.0))
    for index, name in enumerate(facts["names"]):
        is_known = unlit is not None and (patterns[index] == 0).any()
        yield [
            name,
            total.errors[index],
            total.plain_errors[index],
            unlit.errors[index] if unlit is not None and is_known else float("nan"),
            colour_difference(relit[index], truth[index], white),
        ]


def speed_error_table(
    relight_manifests: Iterable[Path], seconds_per_pattern: float
) -> pd.DataFrame:
    """Return cost and error of each acquisition up to each level whose error is known.

    Returns
    -------
    pandas.DataFrame
        ``scene``, ``method``, ``level``; numbers of ``patterns`` and of ``pictures`` on the rig up
        to the level, see `captured_pictures`; ``capture_s``, their time in seconds; mean ``error``.
        Without captures, pictures and time are NaN. A transport that is fitted to all its pictures
        together has a single row, for its last level.
    """
    import pandas as pd

    rows = []
    for manifest in relight_manifests:
        storage = FolderStorage(manifest.parent)
        for facts, _ in _with_truth([manifest]):
            names = [facts[key] for key in _NAMES]
            for level, patterns, error in errors_by_level(facts):
                pictures = captured_pictures(storage, level).total or float("nan")
                seconds = pictures * seconds_per_pattern
                rows.append([*names, level, patterns, pictures, seconds, error])
    columns = [*_NAMES, "level", "patterns", "pictures", "capture_s", "error"]
    return pd.DataFrame(rows, columns=columns)


def errors_by_level(facts: Mapping[str, Any]) -> list[tuple[int, int, float]]:
    """Return levels, patterns up to them and mean errors of a ``relight.json`` with a truth.

    Levels without patterns are omitted, as in ``levels.csv``.
    """
    errors, levels = facts["level_errors"], facts["levels"]
    total_patterns = np.cumsum([row["patterns"] for row in levels])
    if len(errors) == 1:
        used = [index for index, row in enumerate(levels) if is_used(row)]
        last = used[-1] if used else len(levels) - 1
        return [(levels[last]["level"], int(total_patterns[-1]), errors[0])]
    known = zip(levels[-len(errors) :], total_patterns[-len(errors) :], errors, strict=True)
    return [(row["level"], int(count), error) for row, count, error in known if row["patterns"]]


def is_used(level_row: Mapping[str, Any]) -> bool:
    """Test whether a level has patterns or nodes."""
    return bool(level_row["patterns"] or level_row.get("nodes"))


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a table as CSV, with six significant digits."""
    text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(path, text.encode())


def _with_truth(manifests: Iterable[Path]) -> Iterator[tuple[dict[str, Any], ArrayBundle]]:
    for path in manifests:
        images = open_arrays(path.with_suffix(".zarr"))
        if "truth" in images.names:
            yield read_manifest(path), images


def relative_rms(image: Image, truth: Image) -> float:
    """Return ``||image - truth|| / ||truth||`` of radiance (*camera_shape, C).

    NaN if the truth has no light. Raises InputError if the shapes differ.
    """
    image, truth = _checked(image, truth)
    light = float(np.linalg.norm(truth))
    return float(np.linalg.norm(image - truth)) / light if light > 0 else float("nan")


def colour_difference(image: Image, truth: Image, white: float) -> float:
    """Return the mean CIEDE2000 difference over the pixels; about 1 is just noticeable.

    Parameters
    ----------
    image, truth : ndarray, shape (*camera_shape, 1 or 3)
        Radiance, rendered as linear RGB with the sRGB primaries and D65 as white; negative radiance
        is set to 0.
    white : float
        Radiance of white. The result is NaN unless it is positive.

    Raises
    ------
    InputError
        If the shapes differ, or have other channels.
    """
    image, truth = _checked(image, truth)
    if image.shape[-1] not in (1, 3):
        raise InputError(f"images of {image.shape[-1]} channels have no colour; expected 1 or 3")
    if not white > 0:
        return float("nan")
    import colour

    light = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]

    def lab(radiance: Image) -> Image:
        grey_or_rgb = np.maximum(radiance, 0) / white
        rgb = np.broadcast_to(grey_or_rgb, (*radiance.shape[:-1], 3))
        xyz = colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False)
        converted: Image = colour.XYZ_to_Lab(xyz, light)
        return converted

    return float(np.mean(colour.delta_E(lab(image), lab(truth), method="CIE 2000")))


def _checked(image: Image, truth: Image) -> tuple[Image, Image]:
    image, truth = np.asarray(image, np.float64), np.asarray(truth, np.float64)
    if image.shape != truth.shape:
        raise InputError(
            f"an image of shape {image.shape} can't be compared with a truth of {truth.shape}"
        )
    return image, truth
