"""The page of all figures and tables, and Tables 3.1 and 5.1 beside the thesis' numbers."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rfpipe.store.files import write_atomically

# In the order of the thesis.
ORDER = (
    "planes", "laws", "walk", "bottle", "box", "samples", "growth", "arc", "right_angles", "sweets",
    "light_field", "views", "flare", "mosaic", "hard_cases",
)  # fmt: skip

# Table: patterns, megabytes, minutes of each row, and its rays, for brute force takes as many
# patterns; for Table 3.1 computed from its days of a brute-force scan.
THESIS = {
    "3.1": {
        "Fig. 3.4, box": (352, 179, 14, 512 * 512),
        "Fig. 3.7, top": (501, 56, 19, 298_800),
        "Fig. 3.7, bottom": (369, 139, 15, 298_800),
        "Fig. 3.6, bottle": (3_397, 272, 136, 578 * 680),
        "Fig. 3.9, 80 positions": (19_140, 6_675, 1_761, 80 * 162_900),
    },
    "5.1": {
        "Fig. 2.1 (I)": (809, 255, 44, 108_500),
        "Fig. 2.1 (II)": (1_085, 371, 70, 108_500),
        "Fig. 2.1 (III)": (1_081, 334, 65, 108_500),
        "Fig. 2.1 (IV)": (841, 274, 46, 108_500),
        "Fig. 5.6, gummy bears": (2_417, 337, 151, 91_176),
        "Fig. 5.8, 8D": (3_368, 1_470, 484, 233_657),
    },
}
_SECONDS = {"3.1": 60 / 25, "5.1": 2.0}  # a pattern, in the thesis
_NAMES = {"3.1": "dual photography", "5.1": "symmetric photography"}
_CLAIMS = {
    "3.1": "dual photography takes orders of magnitude less time and space than brute force.",
    "5.1": "symmetric photography takes 809 to 3,368 patterns where brute force takes 91,176 to "
    "233,657.",
}
_ACQUIRED = {
    "planes_i": "Fig. 2.1 (I)",
    "planes_ii": "Fig. 2.1 (II)",
    "planes_iii": "Fig. 2.1 (III)",
    "planes_iv": "Fig. 2.1 (IV)",
    "light_field": "Fig. 5.8, 8D",
}
"""Scenes of config/figures.yaml and config/thesis.yaml, which the workflow acquires."""

_FIG_5_10 = (
    "<p><a href='../report/index.html#leaves'>Fig. 5.10</a>. The thesis: at levels 4 to 9 a "
    "significant share of the leaves has rank 1, and a flat plane has far more empty ones than two "
    "planes at an angle.</p>"
)


def write_index(folder: Path) -> None:
    """Write ``index.html`` of what the scripts left in a folder beside a run's report.

    Parameters
    ----------
    folder : Path
        ``results/figures``.
    """
    made = {path.stem: json.loads(path.read_text()) for path in folder.glob("*.json")}
    costs = [*_of_run(folder.parent), *(row for script in made.values() for row in script["costs"])]
    parts = [
        _figure(folder, item) for name in ORDER if name in made for item in made[name]["shown"]
    ]
    for number in THESIS:
        table = cost_table(number, costs, _growth(folder))
        if len(table):
            file = folder / f"table_{number.replace('.', '_')}.csv"
            write_atomically(file, table.to_csv(index=False, float_format="%.6g").encode())
            parts.append(_table(f"Table {number}, {_NAMES[number]}", _COSTS, file, _CLAIMS[number]))
    if (folder.parent / "report" / "index.html").exists():
        parts.append(_FIG_5_10)
    text = _PAGE.format(parts="\n".join(parts))
    write_atomically(folder / "index.html", text.encode())


def _of_run(results: Path) -> Iterator[dict[str, Any]]:
    """Yield the costs of what the run acquired, but by dual photography, from its table."""
    path = results / "report" / "tables" / "results.csv"
    if not path.exists():
        return
    for row in pd.read_csv(path).to_dict("records"):
        if row["method"] != "dual" and row["scene"] in _ACQUIRED:
            yield {"table": "5.1", "figure": _ACQUIRED[row["scene"]],
                   "scene": f"{row['scene']}, {row['method']}", "camera_rays": row["rays"],
                   "error": row["mean_error"], "positions": 1,
                   **{name: row[name] for name in _MEASURED}}  # fmt: skip


_MEASURED = ("rays", "patterns", "pictures", "megabytes", "processing_s")
_COSTS = (
    "Measured at the size of this run: patterns, pictures on the rig for all purposes, minutes "
    "(these pictures at the thesis' seconds each, and the processing as it took here), MB stored, "
    "relative error of relit pictures. Brute force is computed: a pattern a projector pixel, dense "
    "T in three 32-bit floats an entry. Extrapolated: patterns at the thesis' resolution by the "
    "line and the power law of Fig. 3.8, through ours; not measured. Last, the thesis' numbers."
)


def cost_table(number: str, costs: list[dict[str, Any]], growth: pd.DataFrame) -> pd.DataFrame:
    """Return a table of costs beside brute force, and beside the thesis.

    Parameters
    ----------
    number : {"3.1", "5.1"}
    costs : list of dict
        See `figures.common.Cost`.
    growth : DataFrame
        Curves fitted for Fig. 3.8, by their scene; may be empty.
    """
    rows = []
    for figure, (patterns, megabytes, minutes, rays) in THESIS[number].items():
        theirs = {"thesis_patterns": patterns, "thesis_mb": megabytes, "thesis_min": minutes,
                  "thesis_brute_force": rays}  # fmt: skip
        for row in (row for row in costs if row["figure"] == figure):
            scan = row["rays"] * row["positions"]
            seconds = row["pictures"] * _SECONDS[number] + row["processing_s"]
            ours = {
                "figure": figure, "scene": row["scene"], "rays": row["rays"],
                "positions": row["positions"], "brute_force": scan,
                "brute_force_days": scan * _SECONDS[number] / 86_400,
                "dense_gb": scan * row["camera_rays"] * 12 / 1e9,
                "patterns": row["patterns"], "pictures": row["pictures"], "min": seconds / 60,
                "mb": row["megabytes"], "error": row["error"],
            }  # fmt: skip
            curve = "bottle" if "bottle" in figure else "box"
            if number == "3.1" and curve in growth.index:
                at_thesis = 80 if "positions" in figure else 1
                line, power = _extrapolated(growth.loc[curve], row, rays // at_thesis)
                ours |= {"extrapolated_line": at_thesis * line,
                         "extrapolated_power": at_thesis * power}  # fmt: skip
            rows.append({**ours, **theirs})
    return pd.DataFrame(rows)


def _extrapolated(fit: pd.Series[Any], row: dict[str, Any], rays: int) -> tuple[float, float]:
    """Extrapolate the patterns of a row to `rays` by a line and by a power law."""
    patterns, times = row["patterns"] / row["positions"], rays / row["rays"]
    return float(patterns + fit["slope"] * np.log2(times) / 2), float(
        patterns * times ** fit["exponent"]
    )


def _growth(folder: Path) -> pd.DataFrame:
    path = folder / "growth_fits.csv"
    return pd.read_csv(path, index_col="scene") if path.exists() else pd.DataFrame()


def _figure(folder: Path, item: dict[str, Any]) -> str:
    name, caption, thesis = (
        html.escape(item.get(key, "")) for key in ("name", "caption", "thesis")
    )
    if item["file"].endswith(".csv"):
        return _table(name, caption, folder / item["file"])
    vectors = Path(item["file"]).with_suffix(".pdf").name
    return (
        f"<figure><img src='{item['file']}' alt='{name}'><figcaption><b>{name}.</b> "
        f"<i>The thesis: {thesis}</i> {caption} <a href='{vectors}'>{vectors}</a></figcaption>"
        "</figure>"
    )


def _table(name: str, caption: str, file: Path, thesis: str = "") -> str:
    shown = pd.read_csv(file).to_html(
        index=False, border=0, float_format="{:.4g}".format, na_rep=""
    )
    said = f"<i>The thesis: {thesis}</i> " if thesis else ""
    return (
        f"<details{' open' if thesis else ''}><summary>{name}</summary><p>{said}{caption} "
        f"<a href='{file.name}'>{file.name}</a></p>{shown}</details>"
    )


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>The thesis' figures and tables</title>
<style>body {{ font: 16px/1.5 Georgia, serif; max-width: 70rem; margin: 2rem auto }}
img {{ max-width: 100% }} figure {{ margin: 2rem 0 }} table {{ font: 13px system-ui }}
td, th {{ padding: .1rem .5rem; text-align: right }} summary {{ font-weight: bold }}
</style></head><body><h1>The thesis' figures and tables</h1>
<p>G. Garg, Efficiently Acquiring Reflectance Fields Using Patterned Illumination, PhD thesis,
Stanford University, 2006. Each caption says what the thesis claims, then what was measured here.
Errors are relative RMS.</p>
{parts}
</body></html>
"""
