"""The page that tells what was run, with its tables and plots."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from benchmarks.methods.cases import Case
from benchmarks.methods.plots import write_plots
from benchmarks.methods.rows import CASE, newest
from benchmarks.methods.summary import OPEN, failures, sections, summary_of, tightest

from rfpipe.store.files import write_atomically

__all__ = ["write_page"]

FINDINGS = Path(__file__).with_name("findings.md")

_ENOUGH = 0.01  # mean error, for the table of patterns that reach it

_ABOUT = """# The open benchmark

Every method on every physically based scene and on matt wedges, through one camera, as
`make benchmark` runs it. All tables and plots below are made by it from
`benchmark/acquisitions.csv`, which has a row an acquisition; `benchmark/summary.csv` has their
means over seeds. Nothing is extrapolated: what wasn't run isn't there.

- **Light**: the projector is dimmed, or opened, until the brightest pixel of the floodlit scene has
  a radiance of 1.9, of 2 that the default camera takes; `sixteenth` is a sixteenth of that light.
  On wedge IV at 32 x 32 one bracket of a relit picture is off by 0.96 and 0.82 % in total, since
  longer exposures take the direct light, and by 1.6 and 8.6 % where the pattern is dark (29 % at a
  sixty-fourth, which drowns what methods differ by). The columns *photograph* below say so of each
  scene: a method that is better than that has put many pictures together.
- **Errors** are relative RMS of relit pictures: two bars, noise, a binary picture, three small
  spots (12 and twice 4 pixels), the concave edges where surfaces meet; the mean over them, the
  worst, and on the pixels that a pattern leaves dark (rigs whose two sides share their rays).
- **Cost**: patterns; brackets, with the 8 all-off and 64 all-on ones, and the 6 that tell whether a
  rig is coaxial where a method asks; seconds of exposure;
  `light_s`, the projector's light in it: seconds times the share of it that was sent.
- **Held out** are scenes and seeds by the parity of their names' digest
  (`benchmarks.methods.cases.is_held_out`). Methods are worked on with the open ones alone; the held
  out ones have sections of their own, and are looked at last.
- **Grain** is the standard error of a recorded scene's indirect light in a half-lit picture, from
  tracing finitely many paths: it isn't noise to the methods, which see the same matrix in all
  pictures, but detail that no smooth light has.
"""

_RULES = """A refusal; a mean error that rises by a tenth or more as the setting gets tighter; a
target that was missed; an estimate off by a factor of two or more.
"""

_FEWEST = f"""Fewest patterns for a mean error of at most {_ENOUGH:.0%}; where no setting does,
the least error in per cent.
"""

_PLOTS = """Mean errors against patterns, dotted the noise of a single photograph; estimates against
truth, filled where scene and seed are open.
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
    plots = write_plots(folder, summary)
    parts = [
        _ABOUT,
        "## What was run\n",
        _run(rows, asked),
        FINDINGS.read_text(encoding="utf-8") if FINDINGS.exists() else "",
        *_results(summary),
        "## Estimates against truth\n",
        _estimates(summary),
        "## Where methods fail, by rule\n",
        _RULES,
        _failed(summary),
        "## Scenes\n",
        _scenes(rows),
        "## Plots\n",
        _PLOTS,
        *(f"![{name[:-4].replace('_', ' ')}]({folder.name}/{name})\n" for name in plots),
    ]
    page = "\n".join(part for part in parts if part)
    write_atomically(folder.with_suffix(".md"), page.encode())


def _run(rows: pd.DataFrame, asked: Sequence[Case]) -> str:
    """Say what the table holds, from when and where, and what it lacks."""
    there = {tuple(map(str, row)) for row in rows[list(CASE)].itertuples(index=False)}
    codes = {case.key for case in asked}
    lacking = [case for case in asked if _names(case) not in there]
    older = sum(_names(case) in there for case in asked) - len(codes & set(rows["key"]))
    status = rows["status"].value_counts()
    told = (
        f"{len(rows)} acquisitions from {rows['date'].min()} to {rows['date'].max()} on "
        f"{'; '.join(sorted(set(rows['machine'])))}: {status.get('done', 0)} done, "
        f"{status.get('refused', 0)} refused by the method, {status.get('failed', 0)} failed. "
        f"Of the {len(asked)} that the command asked for, {len(lacking)} weren't run"
        + (f"; {older} are of earlier code." if older > 0 else ".")
    )
    counted = rows.assign(section=sections(rows)).groupby(
        ["side", "samples", "light", "seed", "section"], sort=False
    )
    missing: dict[tuple[Any, ...], int] = {}
    for case in lacking:
        key = case.side, case.samples, case.light, case.seed
        missing[key] = missing.get(key, 0) + 1
    found = [
        [*map(str, key), str(len(each)), str(each["scene"].nunique())] for key, each in counted
    ]
    found += [[*map(str, key), "", f"not run: {count}", ""] for key, count in missing.items()]
    head = ["side", "paths a pixel", "light", "seed", "section", "acquisitions", "scenes"]
    return f"{told}\n\n{_markdown(head, found)}"


def _names(case: Case) -> tuple[str, ...]:
    return tuple(str(getattr(case, name)) for name in CASE)


def _results(summary: pd.DataFrame) -> list[str]:
    """Return tables of errors, the open section first."""
    parts = []
    keys = dict.fromkeys(zip(summary["section"], summary["side"], summary["light"], strict=True))
    for section, side, light in sorted(keys, key=lambda key: (key[0] != OPEN, *key[1:])):
        own = summary[
            (summary["section"] == section)
            & (summary["side"] == side)
            & (summary["light"] == light)
        ]
        parts += [
            f"## {section.capitalize()} scenes and seeds, {light} light, side {side}\n",
            "Mean and worst error in per cent (patterns) at the tightest setting that was run.\n",
            _grid(own, tightest(own), _errors),
            _FEWEST,
            _grid(own, own[own["ended"] > 0], _fewest),
        ]
    return parts


def _grid(all_rows: pd.DataFrame, rows: pd.DataFrame, cell: Callable[[pd.DataFrame], str]) -> str:
    """Return a table of scenes by methods; a dash where the method refused."""
    methods = sorted(set(all_rows["method"]))
    lines = []
    for scene in dict.fromkeys(all_rows["scene"]):
        cells = []
        for method in methods:
            at = (rows["scene"] == scene) & (rows["method"] == method)
            tried = ((all_rows["scene"] == scene) & (all_rows["method"] == method)).any()
            cells.append(cell(rows[at]) if at.any() else "-" if tried else "")
        lines.append([scene, *cells])
    return _markdown(["scene", *(f"`{name}`" for name in methods)], lines)


def _errors(rows: pd.DataFrame) -> str:
    row = rows.iloc[-1]
    mean, worst = 100 * row["error_mean"], 100 * row["error_worst"]
    return f"{mean:.2g}, {worst:.2g} ({row['patterns']:.0f})"


def _fewest(rows: pd.DataFrame) -> str:
    enough = rows[rows["error_mean"] <= _ENOUGH]
    if len(enough):
        return f"{enough['patterns'].min():.0f}"
    return f"{100 * rows['error_mean'].min():.2g} %"


def _estimates(summary: pd.DataFrame) -> str:
    known = summary.dropna(subset=["ratio"]).sort_values(
        ["section", "method"], key=lambda each: each.map({OPEN: ""}).fillna(each), kind="stable"
    )
    lines = [
        [
            row["section"], f"`{row['method']}`", row["scene"], row["light"],
            f"{row['value']:g}", f"{row['patterns']:.0f}", f"{row['patterns_by_estimate']:.0f}",
            f"{100 * row['estimated_error']:.2g}",
            f"{100 * row['error_mean']:.2g}", f"{row['ratio']:.2g}",
        ]
        for row in known.to_dict("records")
    ]  # fmt: skip
    head = ["section", "method", "scene", "light", "setting", "patterns",
            "at the estimate", "estimated, %",
            "true, %", "estimate over truth"]  # fmt: skip
    return _markdown(head, lines)


def _failed(summary: pd.DataFrame) -> str:
    found = sorted(
        failures(summary), key=lambda each: (each["section"] != OPEN, each["kind"], each["method"])
    )
    lines = []
    for each in found:
        same = [each["section"], each["kind"], f"`{each['method']}`", each["what"]]
        if lines and lines[-1][:3] + lines[-1][-1:] == same:
            lines[-1][3] += f", {each['scene']} ({each['light']})"
        else:
            lines.append([*same[:3], f"{each['scene']} ({each['light']})", each["what"]])
    return _markdown(["section", "what", "method", "where", "how"], lines)


def _scenes(rows: pd.DataFrame) -> str:
    lines = []
    for (scene, _), own in rows.groupby(["scene", "side"], sort=False):
        done = own[own["status"] == "done"]
        photos = [
            f"{100 * done.loc[done['light'] == light, column].mean():.2g}"
            for light in ("full", "sixteenth")
            for column in ("photo_mean", "photo_unlit")
        ]
        rays = [f"{done[name].max():.0f}" for name in ("camera_rays", "projector_rays")]
        grain = f"{100 * done['grain'].mean():.2g}"
        held = "yes" if own["held_out_scene"].iloc[0] else ""
        lines.append([str(scene), own["what"].iloc[0], held, *rays, grain, *photos])
    head = ["scene", "light is", "held out", "camera rays", "projector rays", "grain, %",
            "photograph, %", "unlit", "at a sixteenth, %", "unlit"]  # fmt: skip
    return _markdown(head, lines).replace(" nan ", "  ")


def _markdown(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return a table of markdown."""
    rows = [list(head), ["---"] * len(head), *lines]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
