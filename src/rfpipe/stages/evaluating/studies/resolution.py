"""Patterns against the projector's resolution [thesis Fig. 3.8]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rfpipe.scenes.reference import reference_scene
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.settings import acquire_options

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["resolution_study"]


def resolution_study(config: Config) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Acquire scene IV in grey at each of ``report.resolutions`` squared, exact radiance.

    Brute force takes one pattern a ray and is computed, not run.

    Returns
    -------
    rows : list of dict
        ``method``, ``side`` in pixels, ``rays``, ``patterns``, and ``rms_total``: the relative
        error of the scene relit with the vertical bar (NaN for brute force).
    arrays : dict
        Empty.
    """
    from rfpipe.rigs import SimulatedRig
    from rfpipe.stages.acquire import acquire

    rows: list[dict[str, Any]] = []
    for side in sorted(set(config.report.resolutions)):
        shape, rays = (side, side), side * side
        row: dict[str, Any] = {"side": side, "rays": rays}
        rows.append({"method": "brute_force", **row, "patterns": rays, "rms_total": float("nan")})
        scene = reference_scene("IV", shape, channels=1)
        bar = relighting_patterns(shape)["vertical_bar"]
        truth = scene.apply(bar[None])[0].reshape(*shape, 1)
        for name, section in config.methods.items():
            rig = SimulatedRig(scene)
            if name == "brute_force":
                continue
            asked = acquire_options(config, name, section)
            result = acquire(rig, progress=False, **asked)
            error = relative_rms(result.transport.relight(bar), truth)
            rows.append({"method": name, **row, "patterns": result.patterns, "rms_total": error})
    return rows, {}
