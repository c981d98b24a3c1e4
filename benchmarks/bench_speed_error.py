"""Error against patterns, for methods, scenes, sizes and noise: results/bench/speed_error.csv.

Usage: ``python benchmarks/bench_speed_error.py [--methods ...] [--scenes ...] [--sizes 64 310x350]
[--noise ...] [--seeds ...] [--channels 1] [--append PATH]``. Every method is run at each of its
settings, in process and through a simulated camera, and relights the patterns of the error tables,
the crease among them. Rows that the table has already are not measured again, so that a sweep may
be stopped and goes on where it was. Which methods a build has, and why one refused a size, is said
on stderr.
"""

from __future__ import annotations

import argparse
import csv
import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from functools import lru_cache
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

import rfpipe
from rfpipe.errors import RfpipeError
from rfpipe.methods import get_method, method_names
from rfpipe.photometry import CameraModel
from rfpipe.report.inputs import COLUMNS
from rfpipe.report.speed_error import against_symmetric, summary_lines
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import RadiosityScene, planes_scene, scene_patterns
from rfpipe.scenes.hard import PLATE
from rfpipe.stages.evaluating.metrics import relative_rms, unlit_rms

OUTPUT = Path("results/bench/speed_error.csv")

# Geometry, surfaces and occluders of each scene.
SCENES: dict[str, tuple[str, tuple[str, ...], tuple[Any, ...]]] = {
    "I": ("plane", ("texture",), ()),
    "II": ("wedge", ("white", "white"), ()),
    "III": ("wedge", ("white", "texture"), ()),
    "IV": ("wedge", ("texture", "texture"), ()),
    "wedge_30": ("wedge_30", ("white", "texture"), ()),
    "wedge_120": ("wedge_120", ("white", "texture"), ()),
    "tilted_wedge": ("tilted_wedge", ("white", "texture"), ()),
    "corner": ("corner", ("texture", "white", "texture"), ()),
    "sphere_on_plane": ("sphere_on_plane", ("texture", "white", "white"), ()),
    "occluder": ("wedge", ("white", "texture"), (PLATE,)),
}
DEFAULT_SCENES = ("II", "IV", "corner")

# Values of the options by which methods trade patterns for accuracy.
VALUES = {
    "tolerance": (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4),
    "target_error": (0.05, 0.02, 0.01, 0.005, 0.002),
    "patterns": (20, 50, 100, 200, 500, 1000),
}
KNOBS = {name: get_method(name).trades for name in method_names()}
DEFAULT_METHODS = ("symmetric", "near_far")

# Low light: a sixteenth of the photons in the same exposures, as with a dimmer projector.
CAMERAS = {
    "default": CameraModel(),
    "low_light": replace(CameraModel(), electrons_per_radiance=640_000 / 16),
}
COMPRESSED_FROM = 64 * 64  # rays from which a scene's form factors are compressed

_log = logging.getLogger("bench_speed_error")


@dataclass(frozen=True)
class Case:
    """One run; the fields are the first columns of the table."""

    method: str
    scene: str
    geometry: str
    height: int
    width: int
    channels: int
    noise: str
    seed: int
    setting: float

    @property
    def key(self) -> tuple[str, ...]:
        """The fields as the table has them."""
        return (*map(str, astuple(self)[:-1]), f"{self.setting:g}")

    @property
    def rays(self) -> int:
        """Rays of the domain, to which the time that a run takes is about proportional."""
        return self.height * self.width

    def __str__(self) -> str:
        """Name the run in a line of the log."""
        size = f"{self.height} x {self.width}"
        knob = KNOBS[self.method]
        told = f", {knob} {self.setting:g}" if knob else ""
        return f"{self.method} on {self.scene}, {size}, {self.noise}, seed {self.seed}{told}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure what is missing in the table, and sum it up."""
    logging.basicConfig(format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    _log.setLevel(logging.INFO)
    logging.getLogger("rfpipe").setLevel(logging.ERROR)
    asked = parsed(arguments)
    asked.append.parent.mkdir(parents=True, exist_ok=True)
    known = rows_of(asked.append)
    cases = [case for case in cases_of(asked) if case.key not in known]
    _log.info("%d runs to do, %d rows in %s", len(cases), len(known), asked.append)
    measure_all(cases, asked.append)
    if asked.append.exists():
        import pandas as pd

        table = pd.read_csv(asked.append)
        beside = against_symmetric(table)
        if len(beside):
            print(beside.to_string(index=False, float_format=lambda value: f"{value:.3g}"))
        print("\n".join(summary_lines(beside)))


def parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--methods", nargs="+", choices=KNOBS, default=DEFAULT_METHODS)
    parser.add_argument("--scenes", nargs="+", choices=[*SCENES, "all"], default=DEFAULT_SCENES)
    parser.add_argument("--sizes", nargs="+", type=size, default=[(32, 32), (64, 64)],
                        help="a side, or HEIGHTxWIDTH")  # fmt: skip
    parser.add_argument("--noise", nargs="+", choices=CAMERAS, default=["default"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--channels", type=int, choices=(1, 3), default=1)
    parser.add_argument("--settings", nargs="+", type=float, help="these instead of the method's")
    parser.add_argument("--append", type=Path, default=OUTPUT, help="the table to go on with")
    return parser.parse_args(arguments)


def size(text: str) -> tuple[int, int]:
    """Read ``64`` or ``310x350``."""
    height, _, width = text.partition("x")
    return int(height), int(width or height)


def cases_of(asked: argparse.Namespace) -> Iterator[Case]:
    """List the runs asked for, sizes first, of the methods that this build has."""
    scenes = list(SCENES) if "all" in asked.scenes else asked.scenes
    for (height, width), scene, seed, noise, method in product(
        asked.sizes, scenes, asked.seeds, asked.noise, asked.methods
    ):
        knob = KNOBS[method]
        for value in (asked.settings or VALUES[knob]) if knob else (0,):
            yield Case(
                method, scene, SCENES[scene][0], height, width, asked.channels, noise, seed, value
            )


def rows_of(path: Path) -> set[tuple[str, ...]]:
    """Return the keys of the rows that a table has."""
    if not path.exists() or not path.stat().st_size:
        return set()
    with path.open(newline="") as file:
        found = csv.DictReader(file)
        if found.fieldnames != list(COLUMNS):
            raise SystemExit(f"{path}: other columns than {', '.join(COLUMNS)}; move it away")
        names = list(COLUMNS)[: len(Case.__dataclass_fields__)]
        return {tuple(row[name] for name in names) for row in found}


def measure_all(cases: Sequence[Case], path: Path) -> None:
    """Run the cases one after the other; append a row each."""
    began, done, total = time.perf_counter(), 0, sum(case.rays for case in cases)
    warm: set[str] = set()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if file.tell() == 0:
            writer.writeheader()
        for number, case in enumerate(cases, start=1):
            if case.method not in warm:
                warm.add(case.method)
                warm_up(case)
            try:
                row = measure(case)
            except RfpipeError as error:
                _log.warning("skipped: %s: %s", case, error)
            else:
                writer.writerow(row)
                file.flush()
                told = (row[name] for name in ("patterns", "error_mean", "error_worst"))
                _log.info("%s: %s patterns, mean error %s, worst %s", case, *told)
            done += case.rays
            minutes = (time.perf_counter() - began) / 60
            _log.info("%d of %d in %.1f min, about %.0f min to go", number, len(cases), minutes,
                      minutes * (total - done) / done)  # fmt: skip


def warm_up(case: Case) -> None:
    """Load and compile what a method needs, so that no run's time includes it."""
    try:
        measure(replace(case, height=8, width=8))
    except RfpipeError as error:
        _log.info("%s can't be warmed up at 8 x 8: %s", case.method, error)


def measure(case: Case) -> Mapping[str, object]:
    """Acquire, relight, compare; return a row of the table."""
    scene, truth = scene_of(case.scene, (case.height, case.width), case.channels, case.seed)
    rig = SimulatedRig(scene, CAMERAS[case.noise], case.seed)
    knob = KNOBS[case.method]
    told: dict[str, Any] = {knob: int(case.setting) if knob == "patterns" else case.setting}
    result = rfpipe.acquire(rig, case.method, progress=False, **(told if knob else {}))
    patterns = scene_patterns(scene)
    relit = result.transport.relight_batch(np.stack(list(patterns.values())))
    pairs = list(zip(relit, truth, patterns.values(), strict=True))
    total = [relative_rms(image, true) for image, true, _ in pairs]
    unlit = [unlit_rms(image, true, pattern) for image, true, pattern in pairs]
    defined = [error for error in unlit if not np.isnan(error)] or [float("nan")]
    history = getattr(result, "history", None)
    known = history is not None and len(history) > 0
    found = {
        "patterns": result.patterns,
        "estimated_error": float(history["estimated_error"].iloc[-1]) if known else float("nan"),
        "error_mean": np.mean(total),
        "error_worst": np.max(total),
        "worst_pattern": list(patterns)[int(np.argmax(total))],
        "unlit_mean": np.mean(defined),
        "unlit_worst": np.max(defined),
        "processing_seconds": result.processing_seconds,
        "transport_mb": result.transport.nbytes / 1e6,
    }
    texts = [f"{value:.5g}" if isinstance(value, float) else value for value in found.values()]
    return dict(zip(COLUMNS, [*case.key, *texts], strict=True))


@lru_cache(maxsize=2)
def scene_of(
    name: str, shape: tuple[int, int], channels: int, seed: int
) -> tuple[RadiosityScene, np.ndarray]:
    """Build a scene, and its true images (P, *shape, C) of the relighting patterns."""
    geometry, surfaces, occluders = SCENES[name]
    scene = planes_scene(
        geometry,
        surfaces,
        shape,
        channels=channels,
        occluders=occluders,
        seed=seed,
        compress=prod(shape) >= COMPRESSED_FROM,
    )
    patterns = np.stack(list(scene_patterns(scene).values()))
    return scene, scene.apply(patterns).reshape(len(patterns), *shape, channels)


if __name__ == "__main__":
    main()
