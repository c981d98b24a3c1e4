"""From a run's settings to what the stages of an acquisition are told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rfpipe.plugins import METHODS
from rfpipe.provenance import fingerprint
from rfpipe.stages.jobs.code import acquisition_code, module_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["asked_of", "simulation_of", "stages_of", "verification_of"]


def stages_of(settings: Config, scene: str, name: str) -> dict[str, Any]:
    """Return arguments of `rfpipe.stages.levels.run` as plain data, the same before any rig.

    Among them is the fingerprint of the stages' code: Snakemake sees no change inside the library.

    Parameters
    ----------
    settings : Config
    scene, name : str
        The acquisition: a scene and a method's section.
    """
    method = settings.methods_of(scene)[name].method or name
    in_collection = settings.collection is not None
    settings = settings.of_scene(scene)
    capture = settings.capture
    share = capture.share_references or ("black" if in_collection else "none")
    return {
        "capture_options": {
            "references": [capture.black_frames, capture.floodlit_frames],
            "symmetry_frames": capture.symmetry_frames,
            "batch_patterns": capture.batch_patterns,
            "drift_patterns": capture.drift_patterns,
            "keep_raw": capture.keep_raw,
            "warm_up_minutes": capture.warm_up_minutes,
            "when_patterns_change": capture.when_patterns_change,
            **({} if share == "none" else {"share": share}),
        },
        "merge_options": {**settings.merge.model_dump(mode="json"), "keep_raw": capture.keep_raw},
        "normalization": settings.normalization,
        "number_format": settings.storage.number_format,
        "asymmetry": capture.asymmetry,
        "watch": {"mode": capture.watch, "looks": capture.looks},
        "code": acquisition_code(module_of(METHODS, method)),
    }


def simulation_of(settings: Config, scene: str) -> dict[str, Any]:
    """Return arguments of `rfpipe.stages.captures.by_simulation` as plain data, but for threads."""
    own = settings.of_scene(scene)
    return {
        "scene": settings.scenes[scene].itself(),
        "camera": own.camera and own.camera.model_dump(mode="json"),
        "seed": own.seed,
        "seconds_per_pattern": own.capture.seconds_per_pattern,
    }


def asked_of(
    plan: Mapping[str, Any],
    stages: Mapping[str, Any],
    simulation: Mapping[str, Any] | None = None,
) -> str:
    """Return the fingerprint of all that an acquisition is asked for.

    It is kept beside the transport, so that a change is seen where Snakemake knows nothing of the
    job.

    Parameters
    ----------
    plan : mapping
        As `rfpipe.stages.plan.plan_of`.
    stages : mapping
        As `stages_of`.
    simulation : mapping, optional
        As `simulation_of`; None for a real rig.
    """
    return fingerprint({"plan": plan, "stages": stages, "simulation": simulation})


def verification_of(settings: Config, scene: str, name: str) -> dict[str, Any]:
    """Return arguments of `rfpipe.stages.unseen.verify.run` as plain data; parameters as there."""
    stages = stages_of(settings, scene, name)
    return {
        "pictures": settings.of_scene(scene).verification_pictures,
        **{part: stages[part] for part in ("code", "capture_options", "merge_options")},
    }
