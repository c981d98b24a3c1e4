"""The page of the open benchmark: three tables and two plots of the acquisitions."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.methods.cases import CASE, Case, is_held_out, method_of, newest
from rfpipe.store.files import write_atomically

FINDINGS = Path(__file__).with_name("findings.md")
OPEN, HELD_OUT = "open", "held out"
_ENOUGH = 0.01  # mean error, for the table of patterns that reach it
_ROSE = 1.1  # errors along a method's settings that rise by more than noise does
_OFF = 2.0  # an estimate this many times the truth, or less than its inverse
_ABREAST = 6

_GROUP = ["section", "what", "scene", "side", "light", "method", "option", "value"]
_MEANS = ["patterns", "brackets", "exposure_s", "light_s", "error_mean", "unlit_mean", "photo_mean",
          "photo_unlit", "grain", "estimated_error", "patterns_by_estimate", "processing_s",
          "stored_mb"]  # fmt: skip

_ABOUT = """# The open benchmark

Every method on every physically based scene and on matt wedges, through one camera, as
`make benchmark` runs it. `benchmark/acquisitions.csv` has a row an acquisition,
`benchmark/summary.csv` their means over seeds; what wasn't run isn't there.

- **Light**: the brightest pixel of the floodlit scene has a radiance of 1.9, of 2 that the default
  camera takes; or a sixteenth of that.
- **Errors** are relative RMS of relit pictures: two bars, noise, a binary picture, three small
  spots (12 and twice 4 pixels), the concave edges where surfaces meet; the mean over them.
- **Held out** are scenes and seeds by the parity of their names' digest. Methods are worked on with
  the open ones alone; the held out ones are looked at last, and marked by a star.
"""
_FEWEST = f"""## Patterns for an error of {_ENOUGH:.0%}

Fewest patterns for such a mean error, in full light; where no setting does, the least error; a dash
where the method refuses the scene.
"""
_BY_METHOD = """## Errors by light

Geometric means over the scenes, at the tightest setting that was run: error, and patterns.
"""
_ESTIMATES = """## Estimates, targets and failures

Of all settings: refused; those where the error rises by a tenth as the setting gets tighter;
targets missed, of those given; the estimate over the true error, its median and range, and how many
are off by a factor of two.
"""
_PLOTS = """## Plots

Mean errors against patterns in full light, dotted the noise of a single photograph; estimates
against truth, filled where scene and seed are open.
"""


def write_page(folder: Path, table: Path, asked: Sequence[Case]) -> None:
    """Write the summary, the plots and the page.

    Parameters
    ----------
    folder : Path
        Of ``summary.csv`` and the plots; the page lies beside it under the same name.
    table : Path
        The acquisitions.
    asked : sequence of Case
        What the command asked for, to say what is missing.
    """
    rows = newest(table)
    summary = summary_of(rows)
    text = summary.to_csv(index=False, float_format="%.5g", lineterminator="\n")
    write_atomically(folder / "summary.csv", text.encode())
    side = rows["side"].value_counts().index[0]
    shown = summary[(summary["side"] == side) & (summary["section"] == _of_scenes(summary))]
    write_atomically(folder / "errors.png", _curves(shown[shown["light"] == "full"]))
    write_atomically(folder / "estimates.png", _against_truth(summary.dropna(subset=["ratio"])))
    parts = [
        _ABOUT,
        _run(rows, asked),
        FINDINGS.read_text(encoding="utf-8"),
        _FEWEST,
        _fewest(shown[shown["light"] == "full"]),
        _BY_METHOD,
        _by_method(shown),
        _ESTIMATES,
        _estimates(summary),
        _PLOTS,
        f"![errors against patterns]({folder.name}/errors.png)\n",
        f"![estimates against truth]({folder.name}/estimates.png)\n",
    ]
    write_atomically(folder.with_suffix(".md"), "\n".join(parts).encode())


def summary_of(table: pd.DataFrame) -> pd.DataFrame:
    """Sum up the acquisitions: a row a section, scene, light, method and setting, over its seeds.

    Parameters
    ----------
    table : DataFrame
        See `benchmarks.methods.cases.newest`.

    Returns
    -------
    DataFrame
        What it is grouped by; how many runs there were, and how many ended; means of patterns,
        costs, errors and estimates, the worst of the worst errors; estimate over truth, the
        geometric mean; why a run didn't end.
    """
    held = table["held_out_scene"].astype(bool) | table["held_out_seed"].astype(bool)
    grouped = table.assign(
        section=held.map({False: OPEN, True: HELD_OUT}),
        ended=table["status"] == "done",
        ratio=np.log(table["estimated_error"] / table["error_mean"]),
    ).groupby(_GROUP, sort=False)
    found = grouped.agg(
        runs=("ended", "size"),
        ended=("ended", "sum"),
        camera_rays=("camera_rays", "max"),
        projector_rays=("projector_rays", "max"),
        **{name: (name, "mean") for name in _MEANS},
        error_worst=("error_worst", "max"),
        unlit_worst=("unlit_worst", "max"),
        ratio=("ratio", "mean"),
        why=("why", "first"),
    )
    found["ratio"] = np.exp(found["ratio"])
    return found.reset_index()


def tightest(summary: pd.DataFrame) -> pd.DataFrame:
    """Return the row of each section, scene, light and method with the tightest ended setting."""
    ended = summary[summary["ended"] > 0]
    ranks = [_rank(*each) for each in zip(ended["method"], ended["value"], strict=True)]
    last = ended.assign(rank=ranks).sort_values("rank", kind="stable")
    place = ["section", "scene", "side", "light", "method"]
    return last.drop_duplicates(place, keep="last").drop(columns="rank").sort_index()


def failures(summary: pd.DataFrame) -> Iterator[tuple[str, str]]:
    """Yield method and what went wrong with it: refused, rises, missed, or off (an estimate)."""
    for (_, method, *_), rows in summary.groupby(["section", "method", "scene", "light"]):
        yield from ((method, "refused") for _ in range(int((rows["ended"] == 0).sum())))
        done = rows[rows["ended"] > 0].to_dict("records")
        done.sort(key=lambda row: _rank(row["method"], row["value"]))
        for coarse, fine in pairwise(done):
            if fine["error_mean"] > _ROSE * coarse["error_mean"]:
                yield method, "rises"
        for row in done:
            if row["option"] == "target_error" and row["error_mean"] > row["value"]:
                yield method, "missed"
            if row["ratio"] > _OFF or row["ratio"] < 1 / _OFF:
                yield method, "off"


def _rank(method: str, value: float) -> int:
    """Place of a setting among a method's trials, from the coarsest."""
    trials = method_of(method).trials
    return trials.index(value) if value in trials else 0


def _of_scenes(summary: pd.DataFrame) -> pd.Series[str]:
    """Return for each row the section that its scene is in, whatever its seed."""
    return summary["scene"].map(lambda name: HELD_OUT if is_held_out(name) else OPEN)


def _run(rows: pd.DataFrame, asked: Sequence[Case]) -> str:
    """Say what the table holds, from when and where, and what it lacks."""
    there = {tuple(map(str, row)) for row in rows[list(CASE)].itertuples(index=False)}
    named = [tuple(str(getattr(case, name)) for name in CASE) for case in asked]
    lacking = sum(name not in there for name in named)
    older = len(asked) - lacking - len({case.key for case in asked} & set(rows["key"]))
    status = rows["status"].value_counts()
    return (
        f"{len(rows)} acquisitions from {rows['date'].min()} to {rows['date'].max()} on "
        f"{'; '.join(sorted(set(rows['machine'])))}: {status.get('done', 0)} done, "
        f"{status.get('refused', 0)} refused by the method, {status.get('failed', 0)} failed. "
        f"Of the {len(asked)} that the command asked for, {lacking} weren't run; {older} are of "
        "earlier code.\n"
    )


def _fewest(summary: pd.DataFrame) -> str:
    """Return a table of scenes by methods."""
    methods = sorted(set(summary["method"]))
    lines = []
    for scene, own in summary.groupby("scene", sort=False):
        cells = []
        for method in methods:
            rows = own[(own["method"] == method) & (own["ended"] > 0)]
            enough = rows[rows["error_mean"] <= _ENOUGH]
            if len(enough):
                cells.append(f"{enough['patterns'].min():.0f}")
            else:
                least = rows["error_mean"].min()
                tried = (own["method"] == method).any()
                cells.append(f"{100 * least:.2g}%" if len(rows) else "-" if tried else "")
        lines.append([f"{scene}{'*' * is_held_out(str(scene))}", *cells])
    return _markdown(["scene", *(f"`{name}`" for name in methods)], lines)


def _by_method(summary: pd.DataFrame) -> str:
    """Return a table of methods by light and section."""
    places = [(light, section) for light in ("full", "sixteenth") for section in (OPEN, HELD_OUT)]
    lines = []
    for method, own in tightest(summary).groupby("method"):
        cells = []
        for light, section in places:
            rows = own[(own["light"] == light) & (own["section"] == section)]
            means = np.exp(np.log(rows[["error_mean", "patterns"]]).mean())
            said = f"{100 * means['error_mean']:.2g}%, {means['patterns']:.0f}"
            cells.append(said if len(rows) else "")
        lines.append([f"`{method}`", *cells])
    return _markdown(["method", *(f"{light}, {section}" for light, section in places)], lines)


def _estimates(summary: pd.DataFrame) -> str:
    """Return a table of what went wrong, and of how good estimates are."""
    wrong = pd.DataFrame(failures(summary), columns=["method", "what"]).value_counts()
    lines = []
    for method, own in summary.groupby("method"):
        refused, rises, missed, off = (
            int(wrong.get((method, what), 0)) for what in ("refused", "rises", "missed", "off")
        )
        targets = int(((own["option"] == "target_error") & (own["ended"] > 0)).sum())
        ratio = own["ratio"].dropna()
        estimated = (
            f"{ratio.median():.2g} ({ratio.min():.2g}-{ratio.max():.2g})" if len(ratio) else ""
        )
        lines.append(
            [f"`{method}`", str(len(own)), str(refused), str(rises),
             f"{missed}/{targets}" if targets else "", estimated, str(off) if len(ratio) else ""]
        )  # fmt: skip
    head = ["method", "settings", "refused", "rises", "missed", "estimate/truth", "off"]
    return _markdown(head, lines)


def _markdown(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table of markdown."""
    rows = [list(head), ["---"] * len(head), *lines]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=100, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def _png(figure: Any) -> bytes:
    """Put one legend above, and return the picture."""
    handles = {}
    for axis in figure.axes:
        handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles, loc="outside upper center", ncols=5, frameon=False)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def _style(method: str) -> dict[str, Any]:
    own = method_of(method)
    return {
        "color": own.colour,
        "marker": own.marker or "x",
        "linestyle": own.line,
        "markersize": 4,
        "label": own.title,
    }


def _curves(summary: pd.DataFrame) -> bytes:
    """Draw mean errors against patterns, a panel a scene."""
    scenes = list(dict.fromkeys(summary["scene"]))
    height = -(-len(scenes) // _ABREAST)
    figure, axes = _figure(height, _ABREAST, (2.4 * _ABREAST, 2.2 * height + 0.5))
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, scene in zip(axes.flat, scenes, strict=False):
        own = summary[(summary["scene"] == scene) & (summary["ended"] > 0)]
        axis.set_axis_on()
        axis.set(xscale="log", yscale="log", xlim=(5, 5000), ylim=(0.05, 100))
        axis.set_title(f"{scene.replace('_', ' ')}{'*' * is_held_out(scene)}", fontsize=9)
        axis.tick_params(labelsize=7)
        for method, each in own.groupby("method"):
            ordered = each.sort_values("patterns")
            axis.plot(ordered["patterns"], 100 * ordered["error_mean"], **_style(str(method)))
        axis.axhline(100 * own["photo_mean"].mean(), color="#888888", linestyle=":",
                     label="a photograph's noise")  # fmt: skip
    figure.supxlabel("patterns", fontsize=9)
    figure.supylabel("mean error, %", fontsize=9)
    return _png(figure)


def _against_truth(summary: pd.DataFrame) -> bytes:
    """Draw estimated errors against true ones: filled where scene and seed are open."""
    methods = list(dict.fromkeys(summary["method"]))
    figure, axes = _figure(1, max(len(methods), 1), (4.0 * max(len(methods), 1), 4.0))
    for axis, method in zip(axes[0], methods, strict=False):
        for section, each in summary[summary["method"] == method].groupby("section"):
            look = {**_style(method), "linestyle": "none", "label": str(section)}
            face = look["color"] if section == OPEN else "white"
            points = 100 * each["error_mean"], 100 * each["estimated_error"]
            axis.plot(*points, **look, markerfacecolor=face)
        axis.plot([0.05, 100], [0.05, 100], color="#888888", linewidth=0.8, label="equal")
        axis.set(xscale="log", yscale="log", xlabel="true mean error, %", ylabel="estimated, %")
        axis.set_title(method_of(method).title, fontsize=9)
    return _png(figure)
