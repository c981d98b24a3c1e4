"""The stage that captures, with its rig, as a job of the workflow has it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from rfpipe.errors import PicturesNeeded
from rfpipe.stages import capture
from rfpipe.stages.folder import AcquisitionFolder

__all__ = ["Capture", "by_pictures", "by_server", "by_simulation", "of_job"]

Capture = Callable[..., None]
"""``capture(folder, level, **options)``: `rfpipe.stages.capture.run` with its rig."""


def of_job(job: Any) -> Capture:
    """Return the capture stage of a job of any kind, by its parameter ``by``."""
    rig, threads = job.params.rig, job.resources.threads
    by: dict[str, Callable[[], Capture]] = {
        "simulation": lambda: by_simulation(**rig, threads=threads),
        "server": lambda: by_server(rig, job.asked),
        "pictures": lambda: by_pictures(**rig),
    }
    return by[job.params.by]()


def by_simulation(
    scene: Mapping[str, Any], camera: Mapping[str, Any] | None, threads: int, **rig: Any
) -> Capture:
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


def by_server(rays: Mapping[str, Any], asked: Any) -> Capture:
    """Return the capture stage of a rig behind a server.

    Parameters
    ----------
    rays : mapping
        Arguments of `rfpipe.stages.hardware.Rays`, which must be the rig's.
    asked : snakemake.io.Resources
        With ``rig_url``, ``rig_token_file``, ``rig_patience`` and ``rig_placing``.
    """
    from rfpipe.stages import hardware
    from rfpipe.stages.capturing.placing import Placing

    return partial(
        hardware.run,
        hardware.Rays(**rays),
        url=asked.rig_url,
        token_file=asked.rig_token_file or None,
        patience_seconds=float(asked.rig_patience),
        placing=Placing(asked.rig_placing or None),
    )


def by_pictures(
    offline: Mapping[str, Any], camera: Mapping[str, Any] | None, **rays: Any
) -> Capture:
    """Return the capture stage of an offline rig, which says which pictures are missing.

    Parameters
    ----------
    offline, camera : mapping
        Settings of the offline rig and of its camera.
    **rays
        Arguments of `rfpipe.stages.hardware.Rays`.
    """
    from rfpipe.config import CameraConfig, OfflineConfig
    from rfpipe.rigs.offline import offline_rig

    rig = offline_rig(
        OfflineConfig(**offline),
        CameraConfig(**camera) if camera else None,
        tuple(rays["camera_shape"]),
        tuple(rays["projector_shape"]),
        rays["channels"],
    )

    def run(folder: AcquisitionFolder, level: int, **options: Any) -> None:
        try:
            capture.run(rig, folder, level, **options)
        except PicturesNeeded as needed:
            raise PicturesNeeded(
                f"{Path(*folder.path.parts[-2:])}: level {level} waits for pictures. Write its "
                "patterns with 'rfpipe patterns CONFIG', take them, and read the pictures with "
                "'rfpipe import FOLDER'"
            ) from needed

    return run
