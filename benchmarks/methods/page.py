"""The page of the open benchmark: tables of regret and of estimates, and plots."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks.methods.cases import (
    AUTO,
    CAMERAS,
    CASE,
    PARTS,
    PLACE,
    Case,
    by_place,
    is_held_out,
    is_needless,
    method_of,
    newest,
)
from benchmarks.methods.scenes import projector_views, shape_of
from rfpipe.methods.adaptive.forecast import EXPECTED, LOWER_QUARTILE, UPPER_QUARTILE
from rfpipe.store.files import write_atomically

TUNING, TEST = "tuning", "test"
_ENOUGH = 0.01  # mean error, for the table of pictures that reach it
_MISSED = 1.2  # true error over target, more than which misses it
_NEAR = 1.5  # an estimate is this many times the truth at most, and its inverse at least
_VISIBLE = 0.25  # of a photograph's noise: the least error that an estimate sees
_ABREAST = 6
_ESTIMATED = {"error_mean": "estimated_error", "indirect_mean": "estimated_indirect"}

_ABOUT = """# The open benchmark

Every method on every physically based scene and on matt wedges, through one camera, as
`make benchmark` runs it. `benchmark/acquisitions.csv` has a row an acquisition,
`benchmark/regret.csv` one of each acquisition of `auto`; settings that ran on less than half of the
scenes are omitted.

- **Light**: the brightest pixel of the floodlit scene has a radiance of 1.9, of 2 that the default
  camera takes; or a sixteenth of that.
- **Errors** are means over 96 pictures of the distribution of `relighting_pictures`: shapes of all
  scales, bars, and spots, a third each; in total, and of the *indirect* light, where the pattern is
  dark, on coaxial rigs.
- **Test scenes** and test seeds are chosen by the parity of their names' digest. Methods are
  developed with all others, the **tuning scenes**, alone; test scenes are evaluated last, and
  marked by a star.
- **Pictures** are all brackets that the rig took, references and symmetry test among them;
  *patterns* are those of the method alone. A real rig takes check and verification pictures
  besides.
"""
_REGRET = """## Regret

Pictures of `auto` over the fewest with which any other method has a true error as small as the
target, at its best setting in hindsight, or over those of brute force. Other methods are counted
with at most the references of `auto`. Geometric means over seeds, then over scenes. `!`: `auto`
missed its target by more than a fifth.
"""
_INDIRECT = """## Regret by indirect light

Pictures of `auto` over the fewest with which any other method has an error of indirect light as
small as `auto` had, whatever its target; 2 means that half of the pictures were enough, less is
better.
"""
_ESTIMATES = f"""## Estimates and targets

Shares of runs whose estimate is within a factor of {_NEAR:g} of the true error, and of targets met
within a fifth.
"""
_FORECASTS = f"""## Forecasts

Shares of runs of `{AUTO}` whose patterns are between the two quartiles of `rfpipe plan`, and whose
cost is within a factor of {_NEAR:g} of its expected number; quartiles of the cost over that number.
Pictures are forecast with the references that the run took.
"""
_FEWEST = f"""## Pictures for an error of {_ENOUGH:.0%}

Fewest pictures on the rig for such a mean error, in full light, and the patterns among them in
brackets: geometric means over seeds. Where it isn't reached on all of them, the least error; a
dash where the method refuses the scene.
"""
_SMALL = f"""## Estimates of small scenes

Estimates of `{AUTO}` over true errors in full light, by height and width: geometric means over
seeds and targets. Below them the same of all runs, the standard deviation of one, and the share of
targets that are met within a fifth. Where errors are below a quarter of a photograph's noise, as of
`plane_i`, estimates are what noise could hide: those runs don't count in the means.
"""
_SIDES = """## By side

Memory is the peak while it acquired, the simulated camera's included, above what was taken before.
"""
_CURVES = """## Errors against pictures

Mean errors against pictures on the rig in full light, dotted the noise of a single photograph.
"""
_PLOT = """## Estimates against truth

Filled where scene and seed are for tuning.
"""


def write_page(folder: Path, table: Path, planned: Sequence[Case]) -> None:
    """Write the table of regrets, the plots and the page.

    Parameters
    ----------
    folder : Path
        Of the tables and the plots; the page lies beside it under the same name.
    table : Path
        The acquisitions.
    planned : sequence of Case
        The cases of the command, to list missing ones.
    """
    rows = newest(table)
    held_out = rows["held_out_scene"].astype(bool) | rows["held_out_seed"].astype(bool)
    rows["section"] = held_out.map({False: TUNING, True: TEST})
    done = rows[rows["status"] == "done"]
    side = rows["side"].value_counts().index[0]
    shown, regret = rows[rows["side"] == side], regrets(done[done["side"] == side])
    full = shown[(shown["light"] == "full") & (shown["section"] == _of_scenes(shown))]
    text = regret.to_csv(index=False, float_format="%.5g", lineterminator="\n")
    write_atomically(folder / "regret.csv", text.encode())
    in_full_light = _of_full_light(folder, full)
    write_atomically(folder / "estimates.png", _against_truth(done[done["side"] == side]))
    rays = done["side"].map(_rays)
    small, sides = small_scenes(done[rays < _rays(side)]), _sides(done[rays >= _rays(side)])
    parts = [
        _ABOUT,
        _run(rows, table, planned),
        _REGRET,
        _regret(regret, "error"),
        _INDIRECT,
        _regret(regret, "indirect"),
        _ESTIMATES,
        _estimates(done[done["side"] == side]),
        _FORECASTS,
        forecasts(done[done["side"] == side]),
        *in_full_light,
        *([_SMALL, small] if small else []),
        *([_SIDES, sides] if sides else []),
        _PLOT,
        f"![estimates against truth]({folder.name}/estimates.png)\n",
    ]
    write_atomically(folder.with_suffix(".md"), "\n".join(parts).encode())


def _of_full_light(folder: Path, rows: pd.DataFrame) -> list[str]:
    """Return the parts of the page about full light, and draw its plot; empty without rows.

    `rows` are the acquisitions in full light.
    """
    done = rows[rows["status"] == "done"]
    if not len(done):
        return []
    write_atomically(folder / "errors.png", _curves(done))
    plot = f"![errors against pictures on the rig]({folder.name}/errors.png)\n"
    return [_FEWEST, _fewest(rows), _CURVES, plot]


def regrets(done: pd.DataFrame) -> pd.DataFrame:
    """Compare each acquisition of `AUTO` with the others of its place, in hindsight.

    Parameters
    ----------
    done : DataFrame
        Acquisitions that ended.

    Returns
    -------
    DataFrame
        ``section``, scene, light and seed, the target and whether it was ``missed``; pictures over
        the fewest of other methods, ``error``, whose true error is as small as the target, and
        ``indirect``, whose error of indirect light is as small as the acquisition's; the methods
        that took the fewest, ``error_by`` and ``indirect_by``, empty where none did and brute
        force's number counts. NaN without other methods, or where the error isn't known.

    Notes
    -----
    Other methods and brute force are counted with at most the references of `AUTO`: these follow
    from its target, and rows of earlier code have more.
    """
    compared = []
    for _, rows in done.groupby(list(PLACE), sort=False):
        rivals = rows[~rows["method"].isin([AUTO, *PARTS])]
        auto_rows = rows[rows["method"] == AUTO]
        compared += [_regret_of(acquisition, rivals) for acquisition in auto_rows.itertuples()]
    columns = ["section", "scene", "light", "seed", "target", "missed", "error", "error_by",
               "indirect", "indirect_by"]  # fmt: skip
    return pd.DataFrame(compared, columns=columns)


def _regret_of(acquisition: Any, rivals: pd.DataFrame) -> dict[str, Any]:
    """Compare an acquisition of `AUTO` with the others of its place."""
    row = {name: getattr(acquisition, name) for name in ("section", "scene", "light", "seed")}
    row["target"] = acquisition.value
    row["missed"] = acquisition.error_mean > _MISSED * acquisition.value
    references = acquisition.pictures - acquisition.patterns
    limits = {"error": acquisition.value, "indirect": acquisition.indirect_mean}
    pictures = rivals["pictures"].clip(upper=rivals["patterns"] + references)
    for name, limit in limits.items():
        is_enough = rivals[f"{name}_mean"] <= limit
        fewest, method = acquisition.projector_rays + references, ""
        if is_enough.any():
            index = pictures[is_enough].idxmin()
            fewest, method = pictures[index], rivals["method"][index]
        is_known = len(rivals) > 0 and not np.isnan(limit)
        row[name] = acquisition.pictures / fewest if is_known else np.nan
        row[f"{name}_by"] = method
    return row


def _of_scenes(rows: pd.DataFrame) -> pd.Series[str]:
    """Return for each row the section that its scene is in, whatever its seed."""
    return rows["scene"].map(lambda name: TEST if is_held_out(name) else TUNING)


def _run(rows: pd.DataFrame, table: Path, planned: Sequence[Case]) -> str:
    """Describe the table: its rows, dates and machine, and missing cases."""
    present = {tuple(map(str, row)) for row in rows[list(CASE)].itertuples(index=False)}
    named = [tuple(str(getattr(case, name)) for name in CASE) for case in planned]
    missing = [case for case, name in zip(planned, named, strict=True) if name not in present]
    older = len(planned) - len(missing) - len({case.key for case in planned} & set(rows["key"]))
    places = by_place(table)
    needless = sum(is_needless(case, places[case.place]) for case in missing)
    status = rows["status"].value_counts()
    return (
        f"{len(rows)} acquisitions from {rows['date'].min()} to {rows['date'].max()} on "
        f"{'; '.join(sorted(set(rows['machine'])))}: {status.get('done', 0)} done, "
        f"{status.get('refused', 0)} refused by the method, {status.get('failed', 0)} failed. "
        f"Of the {len(planned)} planned ones, {needless} weren't needed, since a coarser tolerance "
        "had reached all errors in the comparison; "
        f"{len(missing) - needless} weren't run; {older} are of earlier code.\n"
    )


def _regret(regret: pd.DataFrame, name: str) -> str:
    """Return a table of scenes by light and target, and the means over scenes."""
    regret = regret.dropna(subset=[name])
    counts = regret.groupby(["light", "target"])["scene"].nunique()
    complete = set(
        counts[2 * counts >= counts.max()].index
    )  # settings that were begun only stay in the table
    targets = sorted({target for _, target in complete}, reverse=True)
    places = [place for place in product(CAMERAS, targets) if place in complete]
    grouped = regret.assign(log=np.log(regret[name])).groupby(
        ["section", "scene", "light", "target"], sort=False
    )
    means = grouped.agg(log=("log", "mean"), missed=("missed", "any")).reset_index()
    scenes = means[means["section"] == _of_scenes(means)].groupby("scene", sort=False)

    def cells(rows: pd.DataFrame, marked: bool) -> Iterator[str]:
        for light, target in places:
            section_rows = rows[(rows["light"] == light) & (rows["target"] == target)]
            mark = "!" if marked and section_rows["missed"].any() else ""
            yield f"{np.exp(section_rows['log'].mean()):.2f}{mark}" if len(section_rows) else ""

    lines = [
        [_starred(str(scene)), *cells(section_rows, name == "error")]
        for scene, section_rows in scenes
    ]
    for section, section_rows in means.groupby("section", sort=False):
        lines.append([f"**mean, {section}**", *cells(section_rows, False)])
    return markdown(["scene", *(f"{light}, {100 * target:g}%" for light, target in places)], lines)


def _starred(scene: str) -> str:
    """Return a scene's name in tables."""
    return f"{scene}{'*' * is_held_out(scene)}"


def _fewest(rows: pd.DataFrame) -> str:
    """Return a table of scenes by methods."""
    methods = sorted(set(rows["method"]))
    lines = []
    for scene, of_scene in rows.groupby("scene", sort=False):
        cells = []
        for method in methods:
            tried = of_scene[of_scene["method"] == method]
            method_rows = tried[tried["status"] == "done"]
            reached = method_rows[method_rows["error_mean"] <= _ENOUGH]
            enough = reached.groupby("seed")[["pictures", "patterns"]].min()
            if len(method_rows) and len(enough) == len(set(method_rows["seed"])):
                pictures, patterns = np.exp(np.log(enough).mean())
                cells.append(f"{pictures:.0f} ({patterns:.0f})")
            else:
                least = method_rows.groupby("seed")["error_mean"].min().mean()
                cells.append(f"{least:.2%}" if len(method_rows) else "-" if len(tried) else "")
        lines.append([_starred(str(scene)), *cells])
    return markdown(["scene", *(f"`{name}`" for name in methods)], lines)


def _estimates(done: pd.DataFrame) -> str:
    """Return a table of how good estimates are, and how many targets were met."""
    lines = []
    for (method, light, section), method_rows in done.groupby(
        ["method", "light", "section"], sort=False
    ):
        ratios = [
            method_rows[estimate] / method_rows[true] for true, estimate in _ESTIMATED.items()
        ]
        within = [flags.dropna().between(1 / _NEAR, _NEAR) for flags in ratios]
        targeted = method_rows[method_rows["option"] == "target_error"]
        within.append(targeted["error_mean"] <= _MISSED * targeted["value"])
        if any(map(len, within[:-1])):
            shares = (f"{flags.mean():.0%}" if len(flags) else "" for flags in within)
            lines.append([f"`{method}`", str(light), str(section), str(len(method_rows)), *shares])
    head = ["method", "light", "", "runs", "error estimated", "error of indirect light estimated",
            "targets met"]  # fmt: skip
    return markdown(head, lines)


def forecasts(done: pd.DataFrame) -> str:
    """Return a table of how near the patterns and pictures of `AUTO` are to the forecast."""
    rows = done[(done["method"] == AUTO) & (done["option"] == "target_error")]
    lower, expected, upper = (
        pd.Series(
            [law.at(projector_views(row.scene), row.value) for row in rows.itertuples()],
            rows.index,
        )
        for law in (LOWER_QUARTILE, EXPECTED, UPPER_QUARTILE)
    )
    references = rows["pictures"] - rows["patterns"]
    rows = rows.assign(
        patterns_ratio=rows["patterns"] / expected,
        pictures_ratio=rows["pictures"] / (expected + references),
        is_between=rows["patterns"].between(lower.round(), upper.round()),
    )
    lines = []
    for (light, section), of_section in rows.groupby(["light", "section"], sort=False):
        cells = [f"{of_section['is_between'].mean():.0%}"]
        for name in ("patterns_ratio", "pictures_ratio"):
            quartiles = of_section[name].quantile([0.25, 0.5, 0.75])
            share = of_section[name].between(1 / _NEAR, _NEAR).mean()
            cells += [f"{share:.0%}", ", ".join(f"{ratio:.2f}" for ratio in quartiles)]
        lines.append([str(light), str(section), str(len(of_section)), *cells])
    head = ["light", "", "runs", "between quartiles", "patterns within 1.5",
            "patterns over forecast", "pictures within 1.5", "pictures over forecast"]  # fmt: skip
    return markdown(head, lines)


def _rays(side: str) -> int:
    """Return the rays of a picture of a side."""
    return math.prod(shape_of(side))


def small_scenes(done: pd.DataFrame) -> str:
    """Return a table of estimates over true errors, of scenes by sides; empty where none was."""
    method_rows = done[(done["method"] == AUTO) & (done["light"] == "full")].dropna(
        subset=["estimated_error"]
    )
    method_rows = method_rows.assign(
        log=np.log(method_rows["estimated_error"] / method_rows["error_mean"]),
        met=method_rows["error_mean"] <= _MISSED * method_rows["value"],
    )
    visible = method_rows[
        method_rows["error_mean"] > _VISIBLE * method_rows["photo_mean"].fillna(0)
    ]
    sides = sorted(set(method_rows["side"]), key=_rays)

    def line(name: str, rows: pd.DataFrame, text: Callable[[pd.DataFrame], str]) -> list[str]:
        of_sides = (rows[rows["side"] == side] for side in sides)
        return [name, *(text(side_rows) if len(side_rows) else "" for side_rows in of_sides)]

    lines = [
        line(_starred(str(scene)), rows, lambda side_rows: f"{np.exp(side_rows['log'].mean()):.2f}")
        for scene, rows in method_rows.groupby("scene", sort=False)
    ]
    for section, rows in visible.groupby("section", sort=False):
        lines.append(line(f"**mean, {section}**", rows, _estimates_of))
    return markdown(["scene", *sides], lines) if sides else ""


def _estimates_of(rows: pd.DataFrame) -> str:
    """Return the mean estimate over the truth, its deviation, and the targets met."""
    mean, deviation = np.exp(rows["log"].mean()), rows["log"].std(ddof=0)
    return f"{mean:.2f}, {deviation:.0%}; {rows['met'].mean():.0%} of {len(rows)} met"


def _sides(done: pd.DataFrame) -> str:
    """Return a table of the settings and seeds that were run at several sides; empty for none."""
    setting = ["scene", "light", "seed", "method", "option", "value"]
    several = done.groupby(setting)["side"].transform("nunique") > 1
    lines = []
    for (*named, _, side), setting_rows in done[several].groupby(
        [*setting, "projector_rays", "side"]
    ):
        scene, light, _, method, option, value = named
        mean = setting_rows[
            ["pictures", "patterns", "error_mean", "processing_s", "memory_gb"]
        ].mean()
        lines.append(
            [_starred(scene), light, f"`{method}`", f"{option} {value:g}" if option else "", side,
             f"{mean['pictures']:.0f}", f"{mean['patterns']:.0f}", f"{mean['error_mean']:.2%}",
             f"{mean['processing_s']:.1f}", f"{mean['memory_gb']:.2f}"]
        )  # fmt: skip
    head = ["scene", "light", "method", "setting", "side", "pictures", "patterns", "error",
            "processing, s", "memory, GB"]  # fmt: skip
    return markdown(head, lines) if lines else ""


def markdown(head: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
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
    method_class = method_of(method)
    return {
        "color": method_class.colour,
        "marker": method_class.marker or "x",
        "linestyle": method_class.line,
        "markersize": 4,
        "label": method_class.title,
    }


def _curves(done: pd.DataFrame) -> bytes:
    """Draw mean errors against pictures on the rig, a panel a scene; means over seeds."""
    scenes = list(dict.fromkeys(done["scene"]))
    height = -(-len(scenes) // _ABREAST)
    figure, axes = _figure(height, _ABREAST, (2.4 * _ABREAST, 2.2 * height + 0.5))
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, scene in zip(axes.flat, scenes, strict=False):
        scene_rows = done[done["scene"] == scene]
        axis.set_axis_on()
        axis.set(xscale="log", yscale="log", xlim=(8, 3000), ylim=(0.08, 100))
        axis.set_title(_starred(scene).replace("_", " "), fontsize=9)
        axis.tick_params(labelsize=7)
        for method, method_rows in scene_rows.groupby("method"):
            means = (
                method_rows.groupby("value")[["pictures", "error_mean"]]
                .mean()
                .sort_values("pictures")
            )
            axis.plot(means["pictures"], 100 * means["error_mean"], **_style(str(method)))
        axis.axhline(100 * scene_rows["photo_mean"].mean(), color="#888888", linestyle=":",
                     label="a photograph's noise")  # fmt: skip
    figure.supxlabel("pictures on the rig", fontsize=9)
    figure.supylabel("mean error, %", fontsize=9)
    return _png(figure)


def _against_truth(done: pd.DataFrame) -> bytes:
    """Draw estimated errors against true ones: filled where scene and seed are for tuning.

    A row of panels for each error that methods estimate.
    """
    pairs = [pair for pair in _ESTIMATED.items() if done[list(pair)].notna().all(axis=1).any()]
    methods = list(dict.fromkeys(done["method"][done["estimated_error"].notna()]))
    height, width = max(len(pairs), 1), max(len(methods), 1)
    figure, axes = _figure(height, width, (4.0 * width, 4.0 * height))
    for across, (true, estimated) in zip(axes, pairs, strict=False):
        named = " ".join(reversed(true.split("_")))
        for axis, method in zip(across, methods, strict=False):
            for section, section_rows in done[done["method"] == method].groupby("section"):
                look = {**_style(method), "linestyle": "none", "label": str(section)}
                face = look["color"] if section == TUNING else "white"
                axis.plot(
                    100 * section_rows[true],
                    100 * section_rows[estimated],
                    **look,
                    markerfacecolor=face,
                )
            axis.plot([0.05, 100], [0.05, 100], color="#888888", linewidth=0.8, label="equal")
            axis.set(xscale="log", yscale="log")
            axis.set(xlabel=f"true {named}, %", ylabel=f"estimated {named}, %")
            axis.set_title(method_of(method).title, fontsize=9)
    return _png(figure)
