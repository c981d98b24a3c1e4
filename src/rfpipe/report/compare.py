"""Comparison of methods at equal error: patterns, pictures and seconds that each method needs.

Every acquisition gives points (patterns, error): one for each level if the error is known level by
level, else a single one. The points of all acquisitions of a scene by a method, with any tolerance
or target, make the method's curve: the points with the smallest error for their number of patterns.
Between two points of a curve, costs are interpolated linearly in the logarithm of the error.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.errors import InputError, StoreError
from rfpipe.methods.base import get_method
from rfpipe.provenance import fingerprint
from rfpipe.report.inputs import read_json, seconds_spent
from rfpipe.report.text import rounded_percent
from rfpipe.stages.evaluate import errors_by_level
from rfpipe.storage.base import VERIFICATION_MANIFEST
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.store import open_arrays

if TYPE_CHECKING:
    import pandas as pd

ERRORS = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
"""Errors at which methods are compared by default."""

COLUMNS = ("scene", "error", "method", "patterns", "pictures", "seconds", "note")

_SECONDS_PER_PATTERN = 2.0


@dataclass(frozen=True)
class CostPoint:
    """Cost and error of an acquisition up to a level.

    Attributes
    ----------
    error : float
        Mean error of relit pictures, a fraction.
    patterns : float
        Number of patterns of the method.
    pictures : float
        Number of pictures on the rig for all purposes; NaN where unknown.
    seconds : float
        Time of these pictures and of processing; NaN where unknown.
    """

    error: float
    patterns: float
    pictures: float
    seconds: float


@dataclass(frozen=True)
class Acquired:
    """Points of one acquisition.

    Attributes
    ----------
    folder : Path
        Folder of results.
    scene : str
    truth : str
        Fingerprint of the scene's true floodlit image; "" for a captured scene.
    method : str
        Title of the method.
    variant : str
        Fingerprint of the options, without the one that trades patterns for accuracy.
    points : tuple of CostPoint
    """

    folder: Path
    scene: str
    truth: str
    method: str
    variant: str
    points: tuple[CostPoint, ...]


def compare(
    folders: Sequence[Path],
    errors: Sequence[float] = ERRORS,
    seconds_per_pattern: float | None = None,
) -> pd.DataFrame:
    """Compare the methods of finished runs at equal errors.

    Parameters
    ----------
    folders : sequence of Path
        Folders of results, or of runs.
    errors : sequence of float
        Fractions above 0.
    seconds_per_pattern : float, optional
        Time of a picture on the rig; by default that in each run's settings.

    Returns
    -------
    DataFrame
        `COLUMNS`, with a row for each scene, error and method. Costs are NaN where the method
        doesn't reach the error; the ``note`` says so.

    Raises
    ------
    InputError
        If an error isn't above 0.
    StoreError
        If a folder holds no relit acquisition with a known error.
    """
    import pandas as pd

    wrong = [error for error in errors if not error > 0]
    if wrong:
        raise InputError(f"error {wrong[0]:g}; expected a fraction above 0, such as 0.01")
    acquired = [
        acquisition
        for folder in folders
        for acquisition in acquisitions(folder, seconds_per_pattern)
    ]
    curves = curves_of(acquired)
    rows = [
        {"scene": scene, "error": error, "method": method, **_cost(curve, error)}
        for scene in dict.fromkeys(scene for scene, _ in curves)
        for error in sorted(errors, reverse=True)
        for (curve_scene, method), curve in curves.items()
        if curve_scene == scene
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def acquisitions(folder: Path, seconds_per_pattern: float | None) -> list[Acquired]:
    """Read the acquisitions of a folder of results, or of a run, whose errors are known."""
    results = folder / "results" if (folder / "results").is_dir() else folder
    configuration = _configuration(results)
    stated = configuration.get("capture", {}).get("seconds_per_pattern", _SECONDS_PER_PATTERN)
    seconds = stated if seconds_per_pattern is None else seconds_per_pattern
    read = (
        _acquired(results, path, configuration, seconds)
        for path in sorted(results.glob("*/*/relight.json"))
    )
    known = [acquisition for acquisition in read if acquisition.points]
    if not known:
        raise StoreError(f"{folder}: {_missing(results)}")
    return known


def _missing(results: Path) -> str:
    """Return the reason why no acquisition of a folder can be compared, and the remedy."""
    begun = sorted({level.parent for level in results.glob("*/*/L00")})
    complete = {manifest.parent for manifest in results.glob("*/*/relight.json")}
    names = ", ".join(f"{path.parent.name} by {path.name}" for path in begun[:4])
    if complete:
        return (
            "has relit acquisitions, but no known error: these scenes have neither a truth nor "
            "verification pictures; set verification.pictures, then run again"
        )
    if begun:
        return (
            f"has no relit acquisition ({names}: {begun[0] / 'relight.json'} is missing); "
            "complete the run with 'rfpipe run', then compare"
        )
    return (
        "has no acquisition (no <scene>/<method>/relight.json); name the folder of a "
        "finished run, such as results, or run it first with 'rfpipe run'"
    )


def _configuration(results: Path) -> dict[str, Any]:
    """Return the settings of a run from its report; {} without a report."""
    path = results / "report" / "results.json"
    if not path.is_file():
        return {}
    report = json.loads(path.read_text("utf-8"))
    configuration: dict[str, Any] = report["provenance"]["configuration"]
    return configuration


def _acquired(
    results: Path, manifest: Path, configuration: Mapping[str, Any], seconds: float
) -> Acquired:
    """Read an acquisition by its ``relight.json``."""
    facts, folder = read_json(manifest), manifest.parent
    scene, section = facts["scene"], facts["method"]
    sections = configuration.get("scenes", {}).get(scene, {}).get("methods") or {}
    method_settings = {**configuration.get("methods", {}), **sections}.get(section) or {}
    title, trades = _titled(method_settings.get("method") or section)
    options = {name: value for name, value in facts["options"].items() if name != trades}
    truth = ""
    if "level_errors" in facts:
        truth = fingerprint(open_arrays(manifest.with_suffix(".zarr")).read("floodlit_truth"))
    points = tuple(_points(folder, facts, seconds))
    return Acquired(results, scene, truth, title, fingerprint(options), points)


def _titled(method: str) -> tuple[str, str | None]:
    """Return a method's title and the option that trades patterns for accuracy."""
    try:
        known = get_method(method)
    except InputError:  # a user's method whose file isn't available
        return method, None
    return known.title, known.trades


def _points(folder: Path, facts: Mapping[str, Any], seconds: float) -> Iterator[CostPoint]:
    """Yield the points of an acquisition, a row of `errors_by_level` each."""
    if "level_errors" in facts:
        errors = errors_by_level(facts)
    else:
        error = read_json(folder / VERIFICATION_MANIFEST).get("mean_error")
        last = max((row["level"] for row in facts["levels"]), default=0)
        errors = [] if error is None else [(last, facts["patterns"], error)]
    storage = FolderStorage(folder)
    for level, patterns, error in errors:
        pictures = captured_pictures(storage, level).total or math.nan
        yield CostPoint(error, patterns, pictures, seconds_spent(folder, seconds, level).total)


def curves_of(acquired: Iterable[Acquired]) -> dict[tuple[str, str], list[CostPoint]]:
    """Return the curve of each scene and method, by their names in the table.

    The folder is added to the names of scenes that share their name and differ in their floodlit
    images, a number to methods that differ in their options.
    """
    acquired = list(acquired)
    points: dict[tuple[str, str], list[CostPoint]] = {}
    truths: dict[str, set[str]] = {}
    variants: dict[tuple[str, str], dict[str, None]] = {}
    for item in acquired:
        truths.setdefault(item.scene, set()).add(item.truth)
        variants.setdefault((item.scene, item.method), {})[item.variant] = None
    for item in acquired:
        is_ambiguous = len(truths[item.scene]) > 1
        scene = f"{item.scene} ({item.folder})" if is_ambiguous else item.scene
        options = [*variants[item.scene, item.method]]
        number = options.index(item.variant) + 1
        method = f"{item.method} ({number})" if len(options) > 1 else item.method
        points.setdefault((scene, method), []).extend(item.points)
    return {names: frontier(curve) for names, curve in points.items()}


def frontier(points: Iterable[CostPoint]) -> list[CostPoint]:
    """Return the points with a smaller error than all points with fewer patterns."""
    best: list[CostPoint] = []
    for point in sorted(points, key=lambda point: (point.patterns, point.error)):
        if not best or point.error < best[-1].error:
            best.append(point)
    return best


def _cost(curve: Sequence[CostPoint], error: float) -> dict[str, Any]:
    """Return the cost of an error on a curve, with a note unless it is between two points."""
    reached = next((index for index, point in enumerate(curve) if point.error <= error), None)
    if reached is None:
        last = curve[-1]
        note = f"not reached: {rounded_percent(last.error)} % after {last.patterns:,.0f} patterns"
        return {"note": note}
    after = curve[reached]
    if reached == 0:
        note = f"at most: {rounded_percent(after.error)} % is the largest error known"
        return {**_costs(after), "note": note}
    before = curve[reached - 1]
    share = 1.0
    if after.error > 0:
        share = math.log(before.error / error) / math.log(before.error / after.error)
    pairs = zip(_costs(before).items(), _costs(after).values(), strict=True)
    costs = {name: first ** (1 - share) * last**share for (name, first), last in pairs}
    return {**costs, "note": ""}


def _costs(point: CostPoint) -> dict[str, float]:
    return {name: getattr(point, name) for name in ("patterns", "pictures", "seconds")}
