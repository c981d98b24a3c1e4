"""What jobs took: logs and benchmark files of a run, and the table that is shipped with rfpipe."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.errors import StoreError
from rfpipe.stages.jobs.job import USAGE
from rfpipe.store import read_manifest

if TYPE_CHECKING:
    from rfpipe.config import SceneSettings

__all__ = [
    "JOBS",
    "Record",
    "Subject",
    "Usage",
    "read_shipped",
    "records_in",
    "usage_in",
    "write_records",
]

JOBS = ("acquire", "relight", "verification", "view")
"""Jobs of an acquisition, each with its benchmark file beside the transport."""

_SIMULATING = ("acquire", "relight", "verification")
"""Those that make a simulated scene."""

Usage = tuple[float, float]
"""Memory in MB, and seconds of processor time."""

LIKE = 8.0
"""Jobs tell of those whose pictures are up to so many times as large, or as small."""

_SHIPPED = Path(__file__).with_name("measured.csv")

_USAGE = re.compile(USAGE.replace("%.1f", r"([0-9.]+)").replace("%.2f", r"([0-9.]+)"))

# What is done once a ray, beside what is done once a channel of it. By benchmarks/validate_costs.py
# 1 to 8 tell other sizes alike, 0 and 16 worse.
_ALL_CHANNELS = 1

# Of a job that went on where another was stopped, its benchmark file has the last part alone.
_WHOLE = 0.8


@dataclass(frozen=True)
class Subject:
    """What an acquisition's jobs have before them.

    Attributes
    ----------
    method : str
    size : int
        Of a picture of the camera's, in rays of RGB.
    views : int
        Of the projector.
    simulation_mb : float
        That the simulated scene takes alone, in MB, as far as it is known.
    """

    method: str
    size: float
    views: int
    simulation_mb: float

    @classmethod
    def of(
        cls, method: str, camera_rays: int, channels: int, views: int, simulation_mb: float
    ) -> Subject:
        """Return that of pictures of so many rays and channels."""
        size = camera_rays * (_ALL_CHANNELS + channels) / (_ALL_CHANNELS + 3)
        return cls(method, size, views, simulation_mb)

    def is_like(self, size: float) -> bool:
        """Whether jobs of pictures of a size tell of those of its own."""
        return 1 / LIKE <= size / self.size <= LIKE

    def simulation_of(self, job: str) -> float:
        """Return the MB that its simulated scene takes in a job."""
        return self.simulation_mb if job in _SIMULATING else 0.0


@dataclass(frozen=True)
class Record:
    """What one job took.

    Attributes
    ----------
    job : str
        One of `JOBS`.
    scene, name : str
        The acquisition: its scene, and its method's section.
    method : str
        What it was acquired by, after any choice.
    camera_rays, projector_rays, views, channels : int
        Views of the projector.
    patterns : int
    simulation_mb : float
        As `Subject`'s.
    cpu_seconds : float
        Of the processor, whoever else used it; what a rig waits for isn't in it.
    seconds : float
        Wall time.
    memory_mb : float
        Largest resident set of the job, in MB (10^6 bytes), as the job itself knows it: what
        Snakemake measures it sees now and then, and of a job of seconds it sees the beginning.
    """

    job: str
    scene: str
    name: str
    method: str
    camera_rays: int
    projector_rays: int
    views: int
    channels: int
    patterns: int
    simulation_mb: float
    cpu_seconds: float
    seconds: float
    memory_mb: float

    @property
    def subject(self) -> Subject:
        """What it had before it."""
        return Subject.of(
            self.method, self.camera_rays, self.channels, self.views, self.simulation_mb
        )


def records_in(
    results: Path, scenes: Mapping[str, SceneSettings], most: int | None = None
) -> list[Record]:
    """Return what the jobs of a results' folder took, as far as their files tell.

    Parameters
    ----------
    results : Path
    scenes : mapping
        Settings of the scenes by their names; others are left out.
    most : int, optional
        Acquisitions to look at, evenly among all; None for all.
    """
    found: list[Record] = []
    manifests = sorted(results.glob("*/*/transport.json"))
    for manifest in manifests[:: 1 if most is None else -(-len(manifests) // most) or 1]:
        try:
            about = _about(read_manifest(manifest), scenes)
        except (StoreError, KeyError):
            continue
        for job in JOBS:
            took = _took(manifest.parent, job)
            if took is not None:
                found.append(Record(job=job, **about, **took))
    return found


def read_shipped() -> list[Record]:
    """Return what ``benchmarks/measure_costs.py`` measured."""
    with _SHIPPED.open(encoding="utf-8", newline="") as file:
        return [
            Record(**{field.name: _parsed(row[field.name], field.type) for field in fields(Record)})
            for row in csv.DictReader(file)
        ]


def write_records(records: Iterable[Record], path: Path) -> None:
    """Write records as a table."""
    with path.open("w", encoding="utf-8", newline="") as file:
        names = [field.name for field in fields(Record)]
        writer = csv.DictWriter(file, names, lineterminator="\n")
        writer.writeheader()
        for record in records:
            shown = {
                name: f"{value:.4g}" if isinstance(value, float) else value
                for name, value in asdict(record).items()
            }
            writer.writerow(shown)


def usage_in(log: Path) -> Usage | None:
    """Return what a job took, by the end of its log; None where it isn't told, as of one killed."""
    try:
        last = log.read_text(encoding="utf-8").splitlines()[-1]
    except (OSError, UnicodeDecodeError, IndexError):
        return None
    usage = _USAGE.search(last)
    return None if usage is None else (float(usage[1]), float(usage[2]))


def _about(facts: dict[str, Any], scenes: Mapping[str, SceneSettings]) -> dict[str, Any]:
    shape = tuple(facts["projector_shape"])
    return {
        "scene": facts["scene"],
        "name": facts["method"],
        "method": facts["acquired_by"],
        "camera_rays": prod(facts["camera_shape"]),
        "projector_rays": prod(shape),
        "views": shape[0] if len(shape) > 2 else 1,
        "channels": facts["channels"],
        "patterns": facts["patterns"],
        "simulation_mb": scenes[facts["scene"]].simulation_bytes / 1e6,
    }


def _took(folder: Path, job: str) -> dict[str, Any] | None:
    """Return what a job took in all; None where it went on from another, or isn't known."""
    try:
        seconds = float(_benchmark(folder / f"{job}.benchmark.tsv")["s"])
    except (KeyError, ValueError):
        return None
    usage = usage_in(folder / f"{job}.log")
    if usage is None:
        return None
    memory, cpu = usage
    if job == "acquire":
        stages = [_benchmark(path) for path in folder.glob("L*/*.benchmark.tsv")]
        if seconds < _WHOLE * sum(float(stage.get("s", 0)) for stage in stages):
            return None
    return {"cpu_seconds": cpu, "seconds": seconds, "memory_mb": memory}


def _benchmark(path: Path) -> dict[str, str]:
    try:
        lines = path.read_text(encoding="ascii").splitlines()
        return dict(zip(lines[0].split("\t"), lines[-1].split("\t"), strict=True))
    except (OSError, ValueError, IndexError):
        return {}


def _parsed(text: str, kind: Any) -> Any:
    return {"int": int, "float": float}.get(kind, str)(text)
