"""Inputs of a report: manifests and arrays of the stages, and times of the jobs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import NDArray

from rfpipe.config import Config, SceneSettings
from rfpipe.provenance import fingerprint
from rfpipe.report.drawing import Panel
from rfpipe.report.page import Column
from rfpipe.report.text import words
from rfpipe.storage.base import VERIFICATION_MANIFEST
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.store import ArrayBundle, open_arrays, read_manifest

if TYPE_CHECKING:
    import pandas as pd

_COLOURS = (
    "#0f8a5f", "#d1669a", "#1599ab", "#8a7a00", "#7a4b2a", "#7d5ba6", "#5fa02c", "#e0a100",
    "#1f5a9e", "#c4611a", "#b3263a", "#2a2a2a",
)  # fmt: skip
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "h", "<", ">", "p", "*")


@dataclass(frozen=True)
class RelitAcquisition:
    """Relit acquisition of a scene by a method.

    Attributes
    ----------
    scene, method : str
    settings : SceneSettings
    facts : dict
        The manifest ``relight.json``.
    images : ArrayBundle
        ``relight.zarr``, see `relit_arrays` and `relit_of_captured` in `rfpipe.stages.relight`.
    acquired : dict
        The manifest ``transport.json``; empty where there is none.
    verified : dict
        The manifest ``verification.json``; empty where there is none.
    verified_images : ArrayBundle or None
        ``verification.zarr``, see `rfpipe.stages.verification.Verification`.
    """

    scene: str
    method: str
    settings: SceneSettings
    facts: dict[str, Any]
    images: ArrayBundle
    acquired: dict[str, Any] = field(default_factory=dict)
    verified: dict[str, Any] = field(default_factory=dict)
    verified_images: ArrayBundle | None = None

    @property
    def patterns(self) -> int:
        """Number of patterns."""
        return int(self.facts["patterns"])

    @property
    def rays(self) -> int:
        """Number of the projector's rays, which is the number of patterns of brute force."""
        return math.prod(self.settings.ray_shape)

    @property
    def is_coaxial(self) -> bool:
        """True if camera and projector share their rays, so that unlit pixels are known."""
        return bool(self.facts["coaxial"])

    @property
    def has_truth(self) -> bool:
        """True if the scene's true light transport is known."""
        return "truth" in self.images.names

    @cached_property
    def white(self) -> float:
        """Radiance shown as white: the maximum of the floodlit image, the true image if known."""
        name = "floodlit_truth" if self.has_truth else "floodlit_captured"
        return float(self.read(name).max(initial=0.0)) or 1.0

    def panel(
        self, radiance: NDArray[Any], title: str = "", below: str = "", gain: Any = 1.0
    ) -> Panel:
        """Return a picture (H, W, C) of the scene with the run's exposure."""
        return Panel(radiance, title, below, self.white, gain)

    def rows_of(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of a table with this run's ``scene`` and ``method``."""
        return table[(table["scene"] == self.scene) & (table["method"] == self.method)]

    def read(self, name: str) -> NDArray[Any]:
        """Read one of the arrays."""
        return self.images.read(name)

    def middle(self, images: NDArray[Any]) -> NDArray[Any]:
        """Return images (..., H, W, C) of the camera's rays; the middle view of a light field."""
        if len(self.settings.camera_ray_shape) == 2:
            return images
        rows, columns = self.settings.view_grid
        return images[..., rows // 2 * columns + columns // 2, :, :, :]


@dataclass(frozen=True)
class SeedGroup:
    """Scenes that differ only in their seeds.

    Attributes
    ----------
    name : str
        Common part of their names.
    scenes : tuple of str
    """

    name: str
    scenes: tuple[str, ...]

    @property
    def title(self) -> str:
        """The name, with the number of seeds if there are several."""
        return self.name if len(self.scenes) == 1 else f"{self.name}, {len(self.scenes)} seeds"


@dataclass(frozen=True)
class ReportInputs:
    """Inputs of a report.

    Attributes
    ----------
    config : Config
    runs : list of RelitAcquisition
        In the configuration's order.
    errors, speed_error : DataFrame
        See `rfpipe.stages.evaluate`.
    results : Path
        Folder of results.
    """

    config: Config
    runs: list[RelitAcquisition]
    errors: pd.DataFrame
    speed_error: pd.DataFrame
    results: Path

    @property
    def scenes(self) -> list[str]:
        """The scenes of the runs."""
        return list(dict.fromkeys(run.scene for run in self.runs))

    @property
    def methods(self) -> list[str]:
        """The methods of the runs."""
        return list(dict.fromkeys(run.method for run in self.runs))

    def of_scene(self, scene: str) -> list[RelitAcquisition]:
        """Return the runs of a scene."""
        return [run for run in self.runs if run.scene == scene]

    def light_of(self, scene: str) -> dict[str, Any]:
        """Return a scene's ``choices`` and ``omissions``, see `SceneSettings`; empty if unknown."""
        light: dict[str, Any] = self.of_scene(scene)[0].facts.get("light", {})
        return light

    @cached_property
    def _subjects(self) -> dict[str, Any]:
        sections = (self.config.methods_of(scene).items() for scene in self.config.scenes)
        return {name: section.plugin for group in sections for name, section in group}

    def title(self, method: str) -> str:
        """Return a method's title, with the name of its section in the settings if that differs."""
        subject = self._subjects[method]
        suffix = "" if subject.name == method else f" ({words(method)})"
        return f"{subject.title}{suffix}"

    def style(self, method: str) -> dict[str, Any]:
        """Return matplotlib's label, colour, marker and line of a method's curve.

        Two settings of one method have different colours and markers.
        """
        return self._styles[method]

    @cached_property
    def _styles(self) -> dict[str, dict[str, Any]]:
        styles: dict[str, dict[str, Any]] = {}
        size = {"linewidth": 1.4, "markersize": 4.5, "markerfacecolor": "white"}
        used: dict[str, set[str]] = {"color": set(), "marker": set()}
        for method in self.methods:
            subject = self._subjects[method]
            drawn = {
                "color": _unused(subject.colour, _COLOURS, used["color"]),
                "marker": subject.marker and _unused(subject.marker, _MARKERS, used["marker"]),
            }
            for name, value in drawn.items():
                used[name].add(value)
            styles[method] = {
                "label": self.title(method),
                **drawn,
                "linestyle": subject.line,
                **size,
            }
        return styles

    @cached_property
    def seed_groups(self) -> list[SeedGroup]:
        """The scenes, grouped by their settings without seeds."""
        groups: dict[str, list[str]] = {}
        for scene in self.scenes:
            groups.setdefault(_without_seeds(self.config, scene), []).append(scene)
        return [SeedGroup(_common_name(scenes), tuple(scenes)) for scenes in groups.values()]

    @property
    def labels(self) -> list[Column]:
        """Columns of a table that name a run."""
        return [("scene", "scene", str), ("method", "method", self.title)]


def _unused(preferred: str, alternatives: Sequence[str], used: set[str]) -> str:
    """Return the preferred value if it is unused, else an unused alternative if there is one."""
    return next((it for it in (preferred, *alternatives) if it not in used), preferred)


def _without_seeds(config: Config, scene: str) -> str:
    """Return a fingerprint of the settings that shape a scene's results, except seeds."""
    shaping = config.of_scene(scene).result_settings()
    scene_settings = {**shaping.pop("scenes")[scene], "seed": None, "settings": None}
    methods = {name: section.model_dump() for name, section in config.methods_of(scene).items()}
    return fingerprint([{**shaping, "seed": None}, {**scene_settings, "methods": None}, methods])


def _common_name(scenes: Sequence[str]) -> str:
    """Return the common prefix of scenes' names without digits, or the first name."""
    if len(scenes) == 1:
        return scenes[0]
    alike = takewhile(lambda signs: len({*signs}) == 1, zip(*scenes, strict=False))
    return "".join(signs[0] for signs in alike).rstrip("_0123456789") or scenes[0]


def load_inputs(config: Config, results: Path, errors: Path, speed_error: Path) -> ReportInputs:
    """Read the inputs of a report.

    Parameters
    ----------
    config : Config
    results : Path
        Folder of results. Acquisitions without ``{scene}/{method}/relight.json`` are omitted.
    errors, speed_error : Path
        Tables of the evaluate stage.
    """
    import pandas as pd

    runs = []
    for scene, method in config.acquisitions:
        folder = results / scene / method
        facts, images = _opened(folder / "relight.json")
        if images is None:
            continue
        acquired = read_json(folder / "transport.json")
        verified = (
            _opened(folder / VERIFICATION_MANIFEST) if config.verification_pictures else ({}, None)
        )
        runs.append(
            RelitAcquisition(
                scene, method, config.scenes[scene], facts, images, acquired, *verified
            )
        )
    return ReportInputs(config, runs, pd.read_csv(errors), pd.read_csv(speed_error), results)


def read_json(manifest: Path) -> dict[str, Any]:
    """Return a manifest, or {} if it is missing."""
    return read_manifest(manifest) if manifest.exists() else {}


def _opened(manifest: Path) -> tuple[dict[str, Any], ArrayBundle | None]:
    """Return a manifest and its arrays, or ({}, None) if it is missing."""
    facts = read_json(manifest)
    return facts, open_arrays(manifest.with_suffix(".zarr")) if facts else None


def job_times(folder: Path) -> Iterator[tuple[str, float]]:
    """Yield stage and wall seconds of the jobs of an acquisition that recorded them."""
    for path in sorted([*folder.glob("*.benchmark.tsv"), *folder.glob("L*/*.benchmark.tsv")]):
        stage = path.name.removesuffix(".benchmark.tsv").replace("transport", "assemble")
        seconds = job_seconds(path)
        if seconds is not None and (path.parent != folder or stage == "assemble"):
            yield stage, seconds


def job_seconds(path: Path) -> float | None:
    """Return the wall seconds in a job's ``*.benchmark.tsv``; None if it has none."""
    lines = path.read_text(encoding="ascii").splitlines()[1:]
    return float(lines[0].split("\t")[0]) if lines else None


def rig_of(results: Path, run: RelitAcquisition) -> dict[str, Any]:
    """Return the description of the rig that captured a run, or {}."""
    return dict(read_json(results / run.scene / run.method / "L00/capture.json").get("rig", {}))


class Spent(NamedTuple):
    """Time of an acquisition in seconds.

    Attributes
    ----------
    capture : float
        Time of all pictures on the rig, see `rfpipe.storage.picture_counts`; NaN if their number is
        unknown.
    processing : float
        Wall time of all jobs except captures; NaN if they recorded none.
    """

    capture: float
    processing: float

    @property
    def total(self) -> float:
        """Time of capture, and of processing if it is known."""
        return self.capture + (0.0 if math.isnan(self.processing) else self.processing)


def seconds_spent(folder: Path, seconds_per_picture: float, last_level: float = math.inf) -> Spent:
    """Return the time of an acquisition up to a level, with assembly and verification pictures.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``.
    seconds_per_picture : float
        Time of a picture on the rig in seconds, ``capture.seconds_per_pattern``.
    last_level : float
        Last level to include; by default all levels.
    """
    pictures = captured_pictures(FolderStorage(folder), last_level).total
    jobs = [*seconds_by_level(folder).items()]
    jobs += [(0, seconds) for stage, seconds in job_times(folder) if stage == "assemble"]
    processing = sum(seconds for level, seconds in jobs if level <= last_level)
    return Spent(
        seconds_per_picture * pictures if pictures else math.nan, processing if jobs else math.nan
    )


def seconds_by_level(folder: Path) -> dict[int, float]:
    """Return the wall seconds of the jobs of each level, except captures."""
    seconds: dict[int, float] = {}
    for path in sorted(folder.glob("L[0-9]*/*.benchmark.tsv")):
        stage, level = path.name.removesuffix(".benchmark.tsv"), int(path.parent.name[1:])
        if stage != "capture":
            seconds[level] = seconds.get(level, 0.0) + (job_seconds(path) or 0.0)
    return seconds
