"""Cases of the benchmark: scenes, light levels, seeds, settings of each method; and their table."""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.methods.scenes import settings_of
from benchmarks.rivals import RIVALS
from rfpipe.errors import InputError
from rfpipe.methods import Method, get_method, method_names
from rfpipe.methods.base import options_of
from rfpipe.photometry import CameraModel
from rfpipe.plugins import METHODS, sources_of
from rfpipe.provenance import code_digest, fingerprint

if TYPE_CHECKING:
    import pandas as pd

NAMES = (*method_names(), *RIVALS)
"""The methods that are compared: those installed, and the rivals."""

AUTO = "auto"
"""The method whose regret is measured against the others."""

PARTS = ("near_far", "footprints")
"""What `AUTO` is made of: no rivals of it."""

TARGETS = (0.02, 0.01, 0.005)
"""Mean errors that it is asked for, and other methods that take a target."""

TOLERANCES = (0.06, 0.04, 0.025, 0.015, 0.01, 0.006, 0.004, 0.0025, 0.0015, 0.001, 6e-4, 4e-4, 3e-4)
"""Settings of the other methods, so close that little is lost between two of them."""

SIDE = "48"
"""Pixels along either side of a picture, at which all methods are compared."""

SMALL_SIDES = ("16x18", "24x27", "32x36", "40x45")
"""Heights and widths at which `AUTO` is compared with its own estimates, in full light."""

_SETTINGS = {"target_error": TARGETS, "tolerance": TOLERANCES}
_OWN = Path(__file__).with_name("scenes.py")

_FULL = CameraModel()

CAMERAS = {
    "full": _FULL,
    "sixteenth": replace(_FULL, electrons_per_radiance=_FULL.electrons_per_radiance / 16),
}
"""The default camera under all of the projector's light, and under a sixteenth of it. On wedge IV
at 32 x 32 one bracket of a relit picture is off by 0.96 and 0.82 % in total, since longer exposures
take the direct light, and by 1.6 and 8.6 % where the pattern is dark; by 29 % at 1/64, which drowns
what methods differ by, and by 3.3 % at 1/4, where they hardly feel it."""

SEEDS = (0, 1, 2)
"""Of the camera's noise, the matt scenes' textures and the random pictures that are relit."""


def path_of(name: str) -> str:
    """Return the argument of `rfpipe.acquire` for a name in `NAMES`."""
    return RIVALS.get(name, name)


def method_of(name: str) -> Method[Any]:
    """Return the method of a name in `NAMES`."""
    return get_method(path_of(name))


def is_held_out(name: str) -> bool:
    """Tell whether a scene, or ``"seed 0"``, is looked at last; half of all names are.

    By the parity of the name's digest: nobody chose them, and no result can.
    """
    return bool(int(fingerprint(name), 16) % 2)


@dataclass(frozen=True)
class Case:
    """One acquisition; the fields are columns of the table.

    Attributes
    ----------
    scene : str
        A name in `KINDS`.
    side : str
        Pixels along either side of a picture, "48", or height and width, "310x350".
    channels, samples : int
        Colour channels, paths of light a pixel.
    light : str
        A name in `CAMERAS`.
    seed : int
    method : str
    option : str
        What is traded for accuracy; empty for methods that trade nothing.
    value : float
        Of the option; 0 where there is none.
    """

    scene: str
    side: str
    channels: int
    samples: int
    light: str
    seed: int
    method: str
    option: str
    value: float

    @property
    def options(self) -> dict[str, Any]:
        """Options of the method; whole numbers stay whole."""
        if not self.option:
            return {}
        default = getattr(options_of(method_of(self.method)), self.option)
        return {self.option: round(self.value) if isinstance(default, int) else self.value}

    @property
    def held_out(self) -> dict[str, bool]:
        """Flags of a held-out scene and of a held-out seed."""
        return {
            "held_out_scene": is_held_out(self.scene),
            "held_out_seed": is_held_out(f"seed {self.seed}"),
        }

    @property
    def code(self) -> str:
        """Digest of the code that acquires, and that makes the scene and its pictures."""
        return code_of(self.method)

    @property
    def place(self) -> tuple[Any, ...]:
        """Values in common with the acquisitions to compare with, see `PLACE`."""
        return tuple(getattr(self, name) for name in PLACE)

    @property
    def key(self) -> str:
        """Fingerprint of all that shapes the row but the machine."""
        method = method_of(self.method)
        plain = {field.name: getattr(self, field.name) for field in fields(self)}
        return fingerprint(
            {
                **plain,
                "scene": settings_of(self.scene, self.side, self.channels, self.samples, self.seed),
                "camera": CAMERAS[self.light].describe(),
                "options": options_of(method, **self.options),
                "code": self.code,
            }
        )[:16]

    def __str__(self) -> str:
        """Name the run in a line of the log."""
        setting = f", {self.option} {self.value:g}" if self.option else ""
        return f"{self.method}{setting} on {self.scene}, {self.light} light, seed {self.seed}"


def cases_of(
    scenes: Sequence[str],
    methods: Sequence[str] = (),
    lights: Sequence[str] = tuple(CAMERAS),
    seeds: Sequence[int] = SEEDS,
    settings: int | None = None,
    values: Sequence[float] | None = None,
    side: str = SIDE,
    channels: int = 1,
    samples: int = 16384,
) -> Iterator[Case]:
    """List the runs: seeds that aren't held out first, then by light, scene and method.

    `AUTO` comes first of the methods, and its coarsest setting of each.

    Parameters
    ----------
    scenes
        Names in `KINDS`.
    methods
        All installed methods if empty.
    lights, seeds
    settings
        How many of each method's, from the coarsest; None for all.
    values
        Settings in place of those.
    side, channels, samples
        See `Case`.
    """
    chosen = sorted(map(method_of, methods or NAMES), key=lambda method: method.name != AUTO)
    ordered = sorted(seeds, key=lambda seed: (is_held_out(f"seed {seed}"), seed))
    for seed, light, scene, method in product(ordered, lights, scenes, chosen):
        option = method.trades or ""
        tried = (values or _SETTINGS.get(option, method.trials))[:settings]
        for value in tried if option else (0.0,):
            yield Case(
                scene, side, channels, samples, light, seed, method.name, option, float(value)
            )


PLACE = ("scene", "side", "channels", "samples", "light", "seed")
CASE = tuple(field.name for field in fields(Case))
COLUMNS = (
    "key", *CASE, "what", "held_out_scene", "held_out_seed", "status", "why", "camera_rays",
    "projector_rays", "patterns", "pictures", "exposure_s", "light_s", "error_mean", "error_shapes",
    "error_bars", "error_spots", "error_worst", "indirect_mean", "photo_mean", "photo_indirect",
    "grain", "estimated_error", "estimated_indirect", "processing_s", "memory_gb", "stored_mb",
    "date", "machine", "code",
)  # fmt: skip
"""Columns of the table, see `benchmarks.methods.measure`."""


@cache
def code_of(method: str) -> str:
    """Return the digest of the code that acquires by a method, and that makes the scenes."""
    return code_digest(_OWN, *sources_of(METHODS, path_of(method)))[:16]


Rows = Mapping[tuple[Any, ...], list[Mapping[str, Any]]]


def by_place(path: Path) -> Rows:
    """Return the rows of acquisitions by this code that ended, by `Case.place`."""
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = defaultdict(list)
    for row in newest(path).to_dict("records") if known_keys(path) else ():
        if row["status"] == "done" and row["code"] == code_of(row["method"]):
            groups[tuple(row[field] for field in PLACE)].append(row)
    return groups


def is_needless(case: Case, rows: Iterable[Mapping[str, Any]]) -> bool:
    """Tell whether a coarser tolerance reached all that a case is compared with.

    That is the tightest target, and the least error of indirect light of `AUTO`; or as many
    patterns as brute force takes.

    Parameters
    ----------
    case : Case
    rows : iterable of mapping
        Of its place, those that ended.
    """
    rows = list(rows)
    finer = [row for row in rows if row["method"] == case.method and row["value"] > case.value]
    indirect = (row["indirect_mean"] for row in rows if row["method"] == AUTO)
    least = min((error for error in indirect if not math.isnan(error)), default=math.inf)
    return case.option == "tolerance" and any(
        row["patterns"] >= row["projector_rays"]
        or (row["error_mean"] <= TARGETS[-1] and not row["indirect_mean"] > least)
        for row in finer
    )


def known_keys(path: Path) -> set[str]:
    """Return the keys of the rows that are there.

    Raises
    ------
    InputError
        When the table has other columns.
    """
    if not path.exists() or not path.stat().st_size:
        return set()
    with path.open(newline="") as file:
        reader = csv.DictReader(file)
        if reader.fieldnames != list(COLUMNS):
            raise InputError(f"{path}: expected the columns {', '.join(COLUMNS)}; move it away")
        return {row["key"] for row in reader}


@contextmanager
def appending(path: Path) -> Iterator[Any]:
    """Open the table; yields what appends a row, which is on disk when it returns."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="", lineterminator="\n")
        if file.tell() == 0:
            writer.writeheader()

        def append(row: Mapping[str, object]) -> None:
            writer.writerow(
                {name: f"{x:.5g}" if isinstance(x, float) else x for name, x in row.items()}
            )
            file.flush()

        yield append


def newest(path: Path) -> pd.DataFrame:
    """Return the newest row of each case in `NAMES`, in the order in which they were run."""
    import pandas as pd

    texts = ["side", "option", "status", "why"]
    table = pd.read_csv(
        path, keep_default_na=False, na_values=["", "nan"], dtype=dict.fromkeys(texts, str)
    )
    table[texts] = table[texts].fillna("")
    table = table[table["method"].isin(NAMES)]
    return table.drop_duplicates(list(CASE), keep="last").reset_index(drop=True)
