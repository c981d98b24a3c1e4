"""Stage: how far relit images are from the truth: all error figures of a run, as tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.relighting import picture_squares
from rfpipe.store import ArrayBundle, open_arrays, read_manifest
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd

Image = NDArray[Any]

_ABOUT = ["scene", "method"]


def run(
    relight_manifests: list[Path], errors: Path, speed_error: Path, seconds_per_pattern: float
) -> None:
    """Write `errors_table` and `speed_error_table` as CSV; a figure that isn't defined is blank."""
    write_table(errors, errors_table(relight_manifests))
    write_table(speed_error, speed_error_table(relight_manifests, seconds_per_pattern))


def errors_table(relight_manifests: Iterable[Path]) -> pd.DataFrame:
    """Return the errors of relit images, of each ``relight.json``; a captured scene has none.

    Returns
    -------
    pandas.DataFrame
        ``scene``, ``method``, ``pattern``: those of the reference patterns, and the kinds of
        pictures that the mean is of. ``error`` and ``indirect_error``, that of indirect light, see
        `picture_errors`, of a kind the mean; ``plain_error``: relative to the picture's norm,
        however dark it is. Of the patterns ``ciede2000``, the mean, with the true floodlit image's
        maximum as white.
    """
    import pandas as pd

    columns = [*_ABOUT, "pattern", "error", "plain_error", "indirect_error", "ciede2000"]
    rows: list[list[Any]] = []
    for facts, images in _with_truth(relight_manifests):
        about, nan = [facts[key] for key in _ABOUT], float("nan")
        plain, indirect = (facts.get(f"{name}_errors", {}) for name in ("plain", "indirect"))
        rows += [
            [*about, kind, error, plain.get(kind, nan), indirect.get(kind, nan), nan]
            for kind, error in facts["errors"].items()
        ]
        rows += [[*about, *row] for row in _pattern_rows(facts, images)]
    return pd.DataFrame(rows, columns=columns)


def _pattern_rows(facts: dict[str, Any], images: ArrayBundle) -> Iterator[list[Any]]:
    """Yield the name of each reference pattern and the errors of its relit picture."""
    floodlit = images.read("floodlit_truth")
    relit, truth, patterns = (images.read(name) for name in ("relit", "truth", "patterns"))
    # a camera aside has no pixels that are known to get no direct light
    dark = patterns == 0 if facts["coaxial"] else None
    total, unlit = picture_squares(relit, truth, patterns, floodlit, dark)
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
    """Return cost and error of each acquisition after each level whose error is known.

    Returns
    -------
    pandas.DataFrame
        ``scene``, ``method``, ``level``; ``patterns`` and seconds of capture, ``capture_s``, up to
        there, of all pictures on the rig (of the patterns alone where captures are missing);
        ``error``, the mean. A transport that is fitted to all its pictures together has one row, of
        the last level with any.
    """
    import pandas as pd

    rows = []
    for manifest in relight_manifests:
        pictures = pictures_by_level(manifest.parent)
        for facts, _ in _with_truth([manifest]):
            about = [facts[key] for key in _ABOUT]
            for level, patterns, error in errors_by_level(facts):
                taken = sum(count for at, count in pictures.items() if at <= level) or patterns
                rows.append([*about, level, patterns, taken * seconds_per_pattern, error])
    return pd.DataFrame(rows, columns=[*_ABOUT, "level", "patterns", "capture_s", "error"])


def pictures_by_level(folder: Path) -> dict[int, int]:
    """Return the pictures that a rig took for each level of an acquisition.

    They are of the level's patterns, black and white references, patterns that test symmetry, and
    looks at the rig; those of verification are not counted.
    """
    pictures = {}
    for path in sorted(folder.glob("L[0-9]*/capture.json")):
        facts = read_manifest(path)
        stores = [one for name, one in facts.items() if name != "rig" and isinstance(one, dict)]
        more = sum(one["shape"][0] for one in stores if "digest" in one and "shape" in one)
        pictures[int(path.parent.name[1:])] = facts["patterns"] + more
    return pictures


def errors_by_level(facts: Mapping[str, Any]) -> list[tuple[int, int, float]]:
    """Return level, patterns shown by then and mean error of a ``relight.json`` with a truth.

    Levels without patterns are left out, as they are of ``levels.csv``.
    """
    errors, levels = facts["level_errors"], facts["levels"]
    shown = np.cumsum([row["patterns"] for row in levels])
    if len(errors) == 1:
        used = [index for index, row in enumerate(levels) if is_used(row)]
        last = used[-1] if used else len(levels) - 1
        return [(levels[last]["level"], int(shown[-1]), errors[0])]
    known = zip(levels[-len(errors) :], shown[-len(errors) :], errors, strict=True)
    return [(row["level"], int(count), error) for row, count, error in known if row["patterns"]]


def is_used(level_row: Mapping[str, Any]) -> bool:
    """Whether a level showed patterns or has nodes."""
    return bool(level_row["patterns"] or level_row.get("nodes"))


def write_table(path: Path, table: pd.DataFrame) -> None:
    """Write a table of numbers as CSV, to six digits."""
    text = table.to_csv(index=False, float_format="%.6g", lineterminator="\n")
    write_atomically(path, text.encode())


def _with_truth(manifests: Iterable[Path]) -> Iterator[tuple[dict[str, Any], ArrayBundle]]:
    for path in manifests:
        images = open_arrays(path.with_suffix(".zarr"))
        if "truth" in images.names:
            yield read_manifest(path), images


def relative_rms(image: Image, truth: Image) -> float:
    """Return ``||image - truth|| / ||truth||`` of radiance (*camera_shape, C).

    NaN where there is no light in the truth. Raises InputError when the shapes differ.
    """
    image, truth = _checked(image, truth)
    light = float(np.linalg.norm(truth))
    return float(np.linalg.norm(image - truth)) / light if light > 0 else float("nan")


def colour_difference(image: Image, truth: Image, white: float) -> float:
    """Return the mean CIEDE2000 difference over the pixels; about 1 is just noticed.

    Radiance (*camera_shape, 1 or 3) is rendered as linear RGB with the sRGB primaries and D65 as
    white; `white` is the radiance shown as such. Negative radiance counts as none. NaN when `white`
    isn't above 0. Raises InputError when the shapes differ or have other channels.
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
