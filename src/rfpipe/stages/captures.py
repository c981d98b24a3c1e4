"""The stage that captures, with its rig, as a job of the workflow has it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rfpipe.stages import capture, hardware
from rfpipe.stages.capturing.placing import Placing
from rfpipe.stages.plan import Plan

__all__ = ["by_server", "by_simulation"]


def by_simulation(
    scene: Mapping[str, Any], camera: Mapping[str, Any] | None, threads: int, **rig: Any
) -> Callable[..., None]:
    """Return the capture stage of a simulated rig.

    Parameters
    ----------
    scene, camera : mapping
        Settings of the scene, and of the camera; None for exact radiance.
    threads : int
    **rig
        Of `rfpipe.rigs.SimulatedRig`.
    """
    from rfpipe.config import CameraConfig, SceneSettings
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config

    before = scene_from_config(SceneSettings.model_validate(scene))
    sensor = sensor_from_config(CameraConfig(**camera) if camera else None)
    return partial(capture.run, SimulatedRig(before, sensor, **rig, threads=threads))


def by_server(plan: Plan, resources: Any) -> Callable[..., None]:
    """Return the capture stage of a rig behind a server.

    Parameters
    ----------
    plan : Plan
    resources : snakemake.io.Resources
        With ``rig_url``, ``rig_token_file``, ``rig_patience`` and ``rig_placing``.
    """
    return partial(
        hardware.run,
        plan,
        url=resources.rig_url,
        token_file=resources.rig_token_file or None,
        patience_seconds=float(resources.rig_patience),
        placing=Placing(resources.rig_placing or None),
    )
