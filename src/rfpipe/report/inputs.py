"""What a report is made from: the files that the stages left."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from rfpipe.config import Config, SceneSettings
from rfpipe.report import methods
from rfpipe.report.blocks import Column
from rfpipe.report.light import Light
from rfpipe.stages.relight import right_half
from rfpipe.stages.verification import MANIFEST as VERIFIED
from rfpipe.store import ArrayBundle, open_arrays, read_manifest
from rfpipe.units import SYMMETRY_FRAMES

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Inputs", "Run", "load_inputs"]


@dataclass(frozen=True)
class Run:
    """One scene acquired with one method, relit.

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
    def title(self) -> str:
        """The scene's name."""
        return self.scene

    @property
    def method_title(self) -> str:
        """The method's name in words."""
        return methods.title(self.method)

    @property
    def patterns(self) -> int:
        """Patterns shown."""
        return int(self.facts["patterns"])

    @property
    def rays(self) -> int:
        """Rays of the projector, and so the patterns of brute force."""
        return math.prod(self.settings.ray_shape)

    @property
    def image_shape(self) -> tuple[int, int]:
        """Height and width of the camera's image, or of each view's."""
        height, width = self.settings.camera_ray_shape[-2:]
        return height, width

    @property
    def is_coaxial(self) -> bool:
        """Whether camera and projector share their rays, so that it is known which are unlit."""
        return bool(self.facts["coaxial"])

    @property
    def middle_view(self) -> int:
        """Number of the view in the middle of a light field's array."""
        rows, columns = self.settings.view_grid
        return rows // 2 * columns + columns // 2

    @property
    def has_truth(self) -> bool:
        """Whether the scene's light transport is known, to be compared with."""
        return "truth" in self.images.names

    @property
    def has_leaf_levels(self) -> bool:
        """Whether the level of the leaf is known that holds each entry along a line."""
        return "line_levels" in self.images.names

    @property
    def knows_levels(self) -> bool:
        """Whether its transport is known as of earlier levels than the last."""
        return self.images.shape("levels_relit")[0] > 1

    @cached_property
    def white(self) -> float:
        """Radiance shown as white: the maximum of the floodlit image, the true one if known."""
        name = "floodlit_truth" if self.has_truth else "floodlit_captured"
        return float(self.read(name).max(initial=0.0)) or 1.0

    def light(self, what: str, radiance: NDArray[Any], gain: NDArray[Any] | float = 1.0) -> Light:
        """Return a picture (H, W, C) of the scene with the run's exposure."""
        return Light(self.title, what, radiance, self.white, gain)

    @property
    def has_indirect_light(self) -> bool:
        """Whether the left half of an image gets any light when the right one is lit.

        Of a light field that says nothing: light comes to a view's left half from other views.
        Nor does it of a camera that sees the scene from aside.
        """
        if self.settings.is_light_field or not self.is_coaxial:
            return False
        dark = right_half(self.settings.shape) == 0
        return bool(dark.any() and self.read("half_truth")[dark].max() > 0)

    def own(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of a table with ``scene`` and ``method`` that are this run's."""
        return table[(table["scene"] == self.scene) & (table["method"] == self.method)]

    def read(self, name: str) -> NDArray[Any]:
        """Read one of the arrays."""
        return self.images.read(name)

    def read_shown(self, name: str) -> NDArray[Any]:
        """Read an array of radiance images (..., H, W, C): of several cameras the middle one's."""
        images = self.read(name)
        has_views = len(self.settings.camera_ray_shape) > 2
        return images[..., self.middle_view, :, :, :] if has_views else images


@dataclass(frozen=True)
class Inputs:
    """All that a report shows.

    Attributes
    ----------
    config : Config
    runs : list of Run
        In the configuration's order.
    errors, speed_error : DataFrame
        See `rfpipe.stages.evaluating.evaluate`.
    times : DataFrame
        ``scene``, ``method``, ``level`` (-1 for the transport's assembly), ``stage``,
        ``seconds`` of each stage of each level; may be empty.
    results : Path
        The folder of it all.
    """

    config: Config
    runs: list[Run]
    errors: pd.DataFrame
    speed_error: pd.DataFrame
    times: pd.DataFrame
    results: Path

    @property
    def has_truth(self) -> bool:
        """Whether the scenes' light transport is known; a captured scene is a run's only one."""
        return all(run.has_truth for run in self.runs)

    @property
    def capture_named(self) -> str:
        """What its captures are called."""
        return "simulated capture" if self.config.capture.rig == "simulated" else "capture"

    @property
    def methods(self) -> list[str]:
        """The methods of the runs."""
        return list(dict.fromkeys(run.method for run in self.runs))

    @property
    def light_fields(self) -> list[Run]:
        """The runs of light fields whose light moves from view to view."""
        return [run for run in self.runs if "views_relit" in run.images.names]

    def of_method(self, method: str) -> list[Run]:
        """Return the runs of a method."""
        return [run for run in self.runs if run.method == method]

    @property
    def without_references(self) -> str:
        """What to add where a time is without the brackets that come first, as the costs are."""
        capture = self.config.capture
        if self.config.camera is None:
            return ""
        brackets = capture.black_frames + capture.floodlit_frames
        minutes = brackets * capture.seconds_per_pattern / 60
        looks = SYMMETRY_FRAMES
        more = f"; {looks} random patterns more, to see whether a rig is coaxial" if looks else ""
        return (
            f", without the reference brackets ({capture.black_frames} all-off and "
            f"{capture.floodlit_frames} all-on ones, {minutes:.1f} min{more})"
        )

    @property
    def labels(self) -> list[Column]:
        """The columns that name a run at the left of a table, where records have their names."""
        return [("scene", "scene", self.title_of), ("method", "method", methods.title)]

    @property
    def scenes(self) -> list[str]:
        """The scenes of the runs."""
        return list(dict.fromkeys(run.scene for run in self.runs))

    def title_of(self, scene: str) -> str:
        """Return the title of a scene; its name where no run is of it."""
        return next((run.title for run in self.of_scene(scene)), scene)

    def of_scene(self, scene: str) -> list[Run]:
        """Return the runs of a scene."""
        return [run for run in self.runs if run.scene == scene]


def load_inputs(config: Config, results: Path, errors: Path, speed_error: Path) -> Inputs:
    """Find what the stages left in a results folder.

    Parameters
    ----------
    config : Config
    results : Path
        Holds ``{scene}/{method}/relight.json``; what is missing is not reported.
    errors, speed_error : Path
        The tables of the evaluate stage.
    """
    import pandas as pd

    runs, times = [], []
    for scene, method in config.acquisitions:
        folder = results / scene / method
        manifest = folder / "relight.json"
        if not manifest.exists():
            continue
        images = open_arrays(manifest.with_suffix(".zarr"))
        transport = folder / "transport.json"
        acquired = read_manifest(transport) if transport.exists() else {}
        facts = read_manifest(manifest)
        verified = _verified(folder / VERIFIED) if config.verification_pictures else ({}, None)
        runs.append(Run(scene, method, config.scenes[scene], facts, images, acquired, *verified))
        times += [{"scene": scene, "method": method, **row} for row in _job_times(folder)]
    methods.know(config)
    return Inputs(
        config,
        runs,
        pd.read_csv(errors),
        pd.read_csv(speed_error),
        pd.DataFrame(times, columns=["scene", "method", "level", "stage", "seconds"]),
        results,
    )


def _verified(manifest: Path) -> tuple[dict[str, Any], ArrayBundle | None]:
    """Read what a verification found, if there was one."""
    if not manifest.exists():
        return {}, None
    return read_manifest(manifest), open_arrays(manifest.with_suffix(".zarr"))


def _time_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.benchmark.tsv"))


def _job_times(folder: Path) -> list[dict[str, Any]]:
    """Read the times that the stages of an acquisition left, as many as there are."""
    import pandas as pd

    found = []
    for path in _time_files(folder):
        level, stage = path.parent.name, path.name.removesuffix(".benchmark.tsv")
        seconds = float(pd.read_csv(path, sep="\t")["s"].mean())
        if path.parent != folder and level.startswith("L"):
            found.append({"level": int(level[1:]), "stage": stage, "seconds": seconds})
        elif stage == "transport":
            found.append({"level": -1, "stage": "assemble", "seconds": seconds})
    return found
