"""Cost of an acquisition at any size, fitted to measurements: docs/images/scale.png and a table.

Usage: ``python -m benchmarks.bench_scale [--rays N ...] [--scenes N]``. Reads
docs/scale/measured.csv, whose rows name the place of each measurement, and fits each method's

- patterns and stored megabytes by ``a rays^b``: one power b a method, one factor a for each group
  of rows (a scene, its channels and tolerance, its views);
- seconds of processing by ``c patterns rays`` and peak memory by ``300 MB + c rays``, the median c
  of the rows of 50,000 rays or more: below, start-up is most of either.

Quantities with too few rows aren't predicted. Prints Markdown.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

HERE = Path(__file__).parents[1] / "docs"
MEASURED, FIGURE = HERE / "scale" / "measured.csv", HERE / "images" / "scale.png"
QUANTITIES = ("patterns", "stored_mb", "processing_s", "peak_mb")
NAMES = ("patterns", "MB stored", "seconds of processing", "MB of memory")
LINEAR = {"processing_s": "us a pattern and ray", "peak_mb": "B a ray"}
LARGE = 50_000  # rays
LIBRARIES_MB = 300


def main() -> None:
    """Fit, predict, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rays", nargs="+", type=float, default=[108_500, 1e6, 1e8])
    parser.add_argument("--scenes", type=float, default=1e4, help="of the first number of rays")
    arguments = parser.parse_args()
    fitted = fits(pd.read_csv(MEASURED))
    print(table(fitted, arguments.rays, arguments.scenes))
    draw(pd.read_csv(MEASURED), fitted, arguments.rays[-1])


def fits(measured: pd.DataFrame) -> pd.DataFrame:
    """Return powers and factors, one row a method and quantity.

    Columns: ``method``, ``quantity``, ``power`` (of the rays), ``factor``, ``low`` and ``high`` (of
    the groups' own powers, or of the rows' own factors), ``largest`` (rays measured), ``sizes``.
    """
    rows = []
    for method, method_rows in measured.groupby("method", sort=False):
        for quantity in QUANTITIES:
            measured_rows = method_rows.dropna(subset=[quantity])
            fit = _line if quantity in LINEAR else _power
            if fitted := fit(measured_rows, quantity):
                sizes = {
                    "largest": measured_rows["rays"].max(),
                    "sizes": measured_rows["rays"].nunique(),
                }
                rows.append({"method": method, "quantity": quantity, **fitted, **sizes})
    return pd.DataFrame(rows)


def _power(measured_rows: pd.DataFrame, quantity: str) -> dict[str, float]:
    """Fit a power of the rays with a factor for each group; groups of one size are skipped."""
    logs: Any = np.log(measured_rows[["rays", quantity]].astype(float))
    x, y = logs["rays"], logs[quantity]
    dx, dy = (v - v.groupby(measured_rows["group"]).transform("mean") for v in (x, y))
    if not (dx**2).sum() > 0:
        return {}
    power = float((dx * dy).sum() / (dx**2).sum())
    single_sizes = [
        float((dx[part] * dy[part]).sum() / (dx[part] ** 2).sum())
        for part in (measured_rows["group"] == group for group in measured_rows["group"].unique())
        if (dx[part] ** 2).sum() > 0
    ]
    last = (
        measured_rows["group"] == measured_rows["group"].iloc[int(np.argmax(measured_rows["rays"]))]
    )
    factor = float(np.exp((y - power * x)[last].mean()))
    return {"power": power, "factor": factor, "low": min(single_sizes), "high": max(single_sizes)}


def _line(measured_rows: pd.DataFrame, quantity: str) -> dict[str, float]:
    """Fit costs that grow with the rays, or with rays and patterns, to the large rows."""
    large = measured_rows[measured_rows["rays"] >= LARGE]
    if large.empty:
        return {}
    countray = (large["peak_mb"] - LIBRARIES_MB) / large["rays"]
    if quantity == "processing_s":
        countray = large["processing_s"] / (large["rays"] * large["patterns"])
    return {
        "power": 1.0,
        "factor": countray.median(),
        "low": countray.min(),
        "high": countray.max(),
    }


def predicted(fitted: pd.DataFrame, method: str, quantity: str, rays: float) -> float:
    """Predict the cost of a method at some size; NaN where it wasn't fitted."""
    rows = fitted[fitted["method"] == method].set_index("quantity")
    if quantity not in rows.index:
        return float("nan")
    row: Any = rows.loc[quantity]
    value = float(row["factor"] * rays ** row["power"])
    if quantity == "processing_s":
        return value * predicted(fitted, method, "patterns", rays)
    return value + LIBRARIES_MB if quantity == "peak_mb" else value


def table(fitted: pd.DataFrame, rays: list[float], scenes: float) -> str:
    """Return powers and predictions as a Markdown table."""
    head = [f"{count:,.0f} rays" for count in rays] + [f"{scenes:,.0f} scenes of {rays[0]:,.0f}"]
    titles = ["method", "quantity", "fit (range)", "measured up to", *head]
    lines = [f"| {' | '.join(titles)} |", "|" + "---|" * len(titles)]
    row: Any
    for row in fitted.itertuples():
        values = [predicted(fitted, row.method, row.quantity, count) for count in rays]
        # scenes come one after the other: their memory doesn't add up
        values.append(values[0] * (1 if row.quantity == "peak_mb" else scenes))
        form = f"rays^{row.power:.2f} ({row.low:.2f} to {row.high:.2f})"
        if row.quantity in LINEAR:
            unit = LINEAR[row.quantity]
            form = f"{1e6 * row.factor:.2g} {unit} ({1e6 * row.low:.2g} to {1e6 * row.high:.2g})"
        cells = [row.method, NAMES[QUANTITIES.index(row.quantity)], form, f"{row.largest:,}",
                 *(f"{_rounded(value):,}" for value in values)]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _rounded(value: float) -> float:
    """Return two digits: predictions have no more."""
    digits = 1 - int(np.floor(np.log10(value)))
    return round(value, digits) if digits > 0 else int(round(value, digits))


def draw(measured: pd.DataFrame, fitted: pd.DataFrame, largest: float) -> None:
    """Draw measurements by group, and the fits."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    from rfpipe.methods import get_method

    row: Any
    figure, axes = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
    for axis, quantity, name in zip(axes.ravel(), QUANTITIES, NAMES, strict=True):
        for row in fitted[fitted["quantity"] == quantity].itertuples():
            method = get_method(row.method)
            method_rows = measured[(measured["method"] == row.method) & measured[quantity].notna()]
            axis.plot(
                method_rows["rays"], method_rows[quantity], method.marker, color=method.colour, ms=4
            )
            line = np.geomspace(method_rows["rays"].min(), largest, 50)
            value = [predicted(fitted, row.method, quantity, count) for count in line]
            axis.plot(line, value, "--", color=method.colour, lw=1.2, label=row.method)
        axis.set(xscale="log", yscale="log", xlabel="rays", title=name)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(FIGURE, dpi=90)


if __name__ == "__main__":
    main()
