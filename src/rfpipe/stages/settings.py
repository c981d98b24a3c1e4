"""Settings of the stages of an acquisition, from the configuration of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.config.capture import WatchMode
from rfpipe.errors import ConfigError, InputError, StoreError
from rfpipe.plugins import METHODS, SCENES, is_of_rfpipe, sources_of
from rfpipe.provenance import code_digest, source_digest
from rfpipe.stages.plan import Plan
from rfpipe.stages.prior import prior_file
from rfpipe.storage.base import WhenChanged
from rfpipe.units import SYMMETRY_BRACKETS, NormalizationMode, NumberFormat

if TYPE_CHECKING:
    from rfpipe.config import Config, SceneSettings


@dataclass(frozen=True)
class AcquisitionSettings:
    """Settings of all stages of an acquisition; each stage reads those that it needs.

    Attributes
    ----------
    code : str
        Digest of the code behind the stages, part of the fingerprints of all stages but captures.
    all_off_brackets, all_on_brackets : int, optional
        All-off and all-on brackets with which level 0 begins; None: as many as `target_error` and
        `expected_patterns` need, see `rfpipe.references.reference_brackets`. Exact radiance takes
        one of each.
    target_error : float
        Error of relit pictures to which the reference brackets should hardly add.
    expected_patterns : int
        Patterns that the method is expected to show.
    symmetry_brackets : int
        Brackets of random patterns after them, which measure the rig's symmetry; 0 for none.
    check_interval : int
        Patterns from one check picture to the next, 0 for no check pictures.
    seconds_per_pattern : float
        Seconds that a real rig needs for the bracket of a pattern, for forecasts.
    batch_patterns : int
        Patterns displayed, then stored, at a time; fewer where memory is short. A rig that shows
        sequences takes one sequence at a time.
    when_patterns_change : {"recapture", "refuse"}
        What to do when there are pictures of other patterns or of another rig.
    warm_up_minutes : float
        Minutes of all-on light, unless a bracket was taken that recently.
    watch : {"off", "warn", "refuse"}
        What to do where pictures show that the rig or its light changed.
    accepted_asymmetry : float
        Error in relit pictures, relative to their norm, above which asymmetry shows that a rig has
        changed since its calibration found it coaxial. Only this check uses it; the method is
        chosen by `Plan.accepted_asymmetry`.
    mask_defects : bool
        Whether dead and hot pixels have an infinite variance in all images.
    divide_out_drift : bool
        Whether images are divided by the brightness of the lamp that check pictures measured.
    keep_raw : bool
        Whether brackets stay on the disk after their merge.
    normalization : {"none", "per_channel", "total_energy"}
        Factors by which a level's images add up to the floodlit image.
    scene : str
        Name of the scene, for the transport's manifest.
    number_format : {"float32", "uint16", "uint8"}
        Numbers of the stored transport.
    sources : mapping of str to str
        Digests of the files of a user's scene and method.
    progress : bool
        Whether to show progress.
    """

    code: str = ""
    all_off_brackets: int | None = None
    all_on_brackets: int | None = None
    target_error: float = 0.01
    expected_patterns: int = 30
    symmetry_brackets: int = 0
    check_interval: int = 0
    seconds_per_pattern: float = 2.0
    batch_patterns: int = 16
    when_patterns_change: WhenChanged = "recapture"
    warm_up_minutes: float = 0.0
    watch: WatchMode = "off"
    accepted_asymmetry: float = 1.0
    mask_defects: bool = True
    divide_out_drift: bool = False
    keep_raw: bool = True
    normalization: NormalizationMode = "per_channel"
    scene: str = ""
    number_format: NumberFormat = "float32"
    sources: Mapping[str, str] = field(default_factory=dict)
    progress: bool = True


SETTINGS_OF_STAGE = {
    "schedule": ("code",),
    "capture": (
        "all_off_brackets",
        "all_on_brackets",
        "target_error",
        "expected_patterns",
        "symmetry_brackets",
        "check_interval",
    ),
    "merge": ("code", "mask_defects", "divide_out_drift"),
    "normalize": ("code", "normalization"),
    "refine": ("code",),
    "assemble": ("code", "scene", "number_format", "sources"),
}
"""Names of the settings on which the result of each stage depends, the parameters of its rule.

The code is not among those of captures: an edit takes no picture again.
"""

OPERATING_SETTINGS = (
    "seconds_per_pattern",
    "batch_patterns",
    "warm_up_minutes",
    "when_patterns_change",
    "watch",
    "accepted_asymmetry",
    "keep_raw",
)
"""Names of the settings that have no effect on results. A change of them runs no stage again."""


def stage_settings(config: Config, scene: str, name: str, *stages: str) -> dict[str, Any]:
    """Return the settings on which the results of stages depend, as plain data.

    Parameters
    ----------
    name : str
        Name of the method's section.
    *stages : str
        Names of stages in `SETTINGS_OF_STAGE`; all of them by default.
    """
    plan = Plan.of(**plan_settings(config, scene, name))
    scene_config = config.of_scene(scene)
    capture = scene_config.capture
    all_off = capture.all_off_brackets or capture.precautions.all_off_brackets
    all_on = capture.all_on_brackets or capture.precautions.all_on_brackets
    settings: dict[str, Any] = {
        "code": stage_code(config, scene, name),
        "all_off_brackets": all_off,
        "all_on_brackets": all_on,
        "symmetry_brackets": SYMMETRY_BRACKETS if plan.measures_symmetry else 0,
        "check_interval": capture.precautions.check_interval,
        "mask_defects": scene_config.merge.mask_defects,
        "divide_out_drift": scene_config.divides_out_drift,
        "normalization": scene_config.normalization,
        "scene": scene,
        "number_format": scene_config.storage.number_format,
        "sources": user_sources(config, scene, name),
    }
    if not (all_off and all_on):  # their number follows from these
        settings["target_error"] = plan.target_error
        settings["expected_patterns"] = plan.expected_patterns
    chosen = stages or tuple(SETTINGS_OF_STAGE)
    names = {name for stage in chosen for name in SETTINGS_OF_STAGE[stage]}
    return {name: value for name, value in settings.items() if name in names}


def operating_settings(config: Config, scene: str) -> dict[str, Any]:
    """Return the `OPERATING_SETTINGS` of a scene."""
    capture = config.of_scene(scene).capture
    return {
        "seconds_per_pattern": capture.seconds_per_pattern,
        "batch_patterns": capture.batch_patterns,
        "warm_up_minutes": capture.warm_up_minutes,
        "when_patterns_change": capture.when_patterns_change,
        "watch": "off" if capture.rig == "simulated" else capture.watch,
        "accepted_asymmetry": capture.asymmetry,
        "keep_raw": capture.keep_raw,
    }


def operating_settings_from_text(texts: Mapping[str, str]) -> dict[str, Any]:
    """Parse the `OPERATING_SETTINGS`, which a job has as text among its resources."""
    return {
        "seconds_per_pattern": float(texts["seconds_per_pattern"]),
        "batch_patterns": int(texts["batch_patterns"]),
        "warm_up_minutes": float(texts["warm_up_minutes"]),
        "when_patterns_change": texts["when_patterns_change"],
        "watch": texts["watch"],
        "accepted_asymmetry": float(texts["accepted_asymmetry"]),
        "keep_raw": texts["keep_raw"] == "True",
    }


def plan_settings(config: Config, scene: str, name: str) -> dict[str, Any]:
    """Return the arguments of `Plan.of` for one method of a scene, as plain data."""
    section, rays = config.methods_of(scene)[name], _rays(config.scenes[scene])
    return {
        "name": name,
        "method": section.method or name,
        "rays": [rays["camera_shape"], rays["projector_shape"], rays["channels"]],
        "options": section.options(),
        "accepted_asymmetry": config.of_scene(scene).capture.asymmetry,
    }


def prior_inputs(config: Config, scene: str, name: str) -> list[str]:
    """Return the file that changes with the prior of an acquisition; no file without a prior.

    InputError if there is no such prior.
    """
    path = config.methods_of(scene)[name].prior_path
    return [] if path is None else [str(prior_file(path))]


def check_priors(config: Config, results: Path) -> None:
    """Check the priors of all acquisitions of a run.

    Raises
    ------
    ConfigError
        For a prior that doesn't exist, can't be read, is of another rig, or is a result of this
        run. The message names scene, method and path.
    """
    own = {(results / scene / name).resolve() for scene, name in config.acquisitions}
    for scene, name in config.acquisitions:
        path = config.methods_of(scene)[name].prior_path
        if path is None:
            continue
        setting = f"scenes.{scene}: methods.{name}.prior"
        if own & {Path(path).resolve(), *Path(path).resolve().parents}:
            raise ConfigError(
                f"{setting} is {path!r}, a result of this run, which would replace it; acquire in "
                "another folder (rfpipe run --directory), or copy the prior to another folder"
            )
        try:
            Plan.of(**plan_settings(config, scene, name))
        except (InputError, StoreError) as error:
            raise ConfigError(f"{setting}: {error}") from error


def rig_source_settings(config: Config, scene: str) -> dict[str, Any]:
    """Return the arguments of `rfpipe.stages.rig_sources.rig_source` for a scene."""
    scene_settings, scene_config = config.scenes[scene], config.of_scene(scene)
    camera = {"camera": scene_config.camera and scene_config.camera.model_dump(mode="json")}
    if config.capture.rig == "remote":
        return {"kind": "remote", "settings": _rays(scene_settings)}
    if config.capture.rig == "offline":
        offline = scene_config.offline.model_dump(mode="json")
        return {
            "kind": "offline",
            "settings": {"offline": offline, **camera, **_rays(scene_settings)},
        }
    settings = {"scene": scene_settings.scene_options(), **camera, "seed": scene_config.seed}
    return {"kind": "simulated", "settings": settings}


def stage_code(config: Config, scene: str, name: str | None = None, *, pages: bool = False) -> str:
    """Return the digest of the code behind an acquisition's results; see `code_digest`.

    It includes the files of a user's own scene and method.
    """
    classes = _classes(config, scene, name).values()
    return code_digest(*(path for entry in classes for path in sources_of(*entry)), pages=pages)


def user_sources(config: Config, scene: str, name: str) -> dict[str, str]:
    """Digests of the files of a user's scene and method, by ``scene`` and ``method``.

    Classes of rfpipe and its extras have no entry.
    """
    return {
        role: source_digest(*sources_of(*entry))
        for role, entry in _classes(config, scene, name).items()
        if not is_of_rfpipe(*entry)
    }


def _classes(config: Config, scene: str, name: str | None) -> dict[str, tuple[str, str]]:
    """Groups and names of the classes of a scene and its method; see `rfpipe.plugins`."""
    classes = {"scene": (SCENES, config.scenes[scene].kind)}
    if name is not None:
        classes["method"] = (METHODS, config.methods_of(scene)[name].method or name)
    return classes


def _rays(scene: SceneSettings) -> dict[str, Any]:
    shapes = {"camera_shape": scene.camera_ray_shape, "projector_shape": scene.ray_shape}
    return {**{name: list(shape) for name, shape in shapes.items()}, "channels": scene.channels}
