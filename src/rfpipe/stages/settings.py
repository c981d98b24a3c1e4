"""From a run's settings to what the stages of an acquisition are told, as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rfpipe.config.capture import SYMMETRY_FRAMES
from rfpipe.plugins import METHODS, SCENES, sources_of
from rfpipe.provenance import code_digest
from rfpipe.units import SATURATION_FRACTION

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.config.base import MethodSettings

__all__ = ["acquire_options", "code_of", "rig_of", "stages_of"]

_CAPTURE = ("black_frames", "floodlit_frames", "asymmetry")


def acquire_options(config: Config, name: str, section: MethodSettings) -> dict[str, Any]:
    """Return keyword arguments of `acquire` for a method's section of this name."""
    return {
        "method": section.method or name,
        **section.options(),
        **config.capture.model_dump(include=set(_CAPTURE)),
        **config.merge.model_dump(exclude={"divide_out_drift"}),  # in process none is watched
        "normalization": config.normalization,
    }


def stages_of(config: Config, scene: str, name: str) -> dict[str, dict[str, Any]]:
    """Return the settings of each stage of an acquisition, the same before any rig.

    Among them is the digest of the code, but of captures: an edit takes no picture again.

    Parameters
    ----------
    config : Config
    scene, name : str
        The acquisition: a scene and a method's section.

    Returns
    -------
    dict of str to dict
        Keyword arguments of "schedule", "capture", "merge", "normalize", "refine" and "assemble".
    """
    from rfpipe.stages.plan import Plan, plan_of
    from rfpipe.stages.symmetry import NOTICED

    plan = Plan(**plan_of(config, scene, name))
    code = {"code": code_of(config, scene, name)}
    of_scene = config.of_scene(scene)
    capture = of_scene.capture
    default = "none" if config.collection is None else "black"
    captured = {
        "references": [capture.black_frames, capture.floodlit_frames],
        "symmetry_frames": SYMMETRY_FRAMES if plan.asks_symmetry else 0,
        "batch_patterns": capture.batch_patterns,
        "drift_patterns": capture.drift_patterns,
        "warm_up_minutes": capture.warm_up_minutes,
        "when_patterns_change": capture.when_patterns_change,
        "watching": {
            "mode": capture.watch,
            "looks": capture.looks,
            "mutual_error": NOTICED * capture.asymmetry,
        },
        "share": capture.share_references or default,
    }
    merged = {
        **of_scene.merge.model_dump(mode="json"),
        "saturation_fraction": SATURATION_FRACTION,
        "keep_raw": capture.keep_raw,
    }
    return {
        "schedule": code,
        "capture": captured,
        "merge": {**merged, **code},
        "normalize": {"mode": of_scene.normalization, **code},
        "refine": code,
        "assemble": {"scene": scene, "number_format": of_scene.storage.number_format, **code},
    }


def code_of(config: Config, scene: str, name: str | None = None, *, pages: bool = False) -> str:
    """Return the digest of the code behind an acquisition's results; see `code_digest`.

    The files of a scene and a method of a user's own count, too.
    """
    used = [(SCENES, config.scenes[scene].kind)]
    if name is not None:
        used.append((METHODS, config.methods_of(scene)[name].method or name))
    return code_digest(*(path for each in used for path in sources_of(*each)), pages=pages)


def rig_of(config: Config, scene: str) -> dict[str, Any]:
    """Return what the capture stage's rig is made of; see `rfpipe.stages.captures`."""
    about, of_scene = config.scenes[scene], config.of_scene(scene)
    camera = of_scene.camera and of_scene.camera.model_dump(mode="json")
    rays = {
        "camera_shape": list(about.camera_ray_shape),
        "projector_shape": list(about.ray_shape),
        "channels": about.channels,
    }
    if config.capture.rig == "remote":
        return {"by": "server", "rig": rays}
    if config.capture.rig == "offline":
        offline = of_scene.offline.model_dump(mode="json")
        return {"by": "pictures", "rig": {"offline": offline, "camera": camera, **rays}}
    return {
        "by": "simulation",
        "rig": {
            "scene": about.itself(),
            "camera": camera,
            "seed": of_scene.seed,
            "seconds_per_pattern": of_scene.capture.seconds_per_pattern,
        },
    }
