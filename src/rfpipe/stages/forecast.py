"""What a run will take, before the lamp is switched on: patterns, time, memory and disk."""

from __future__ import annotations

import logging
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.errors import StoreError
from rfpipe.store import files
from rfpipe.units import RADIANCE, SYMMETRY_FRAMES

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config
    from rfpipe.photometry import Sensor

_BLOCK_BYTES = 4096  # a file takes whole blocks of its file system

_log = logging.getLogger(__name__)


def disk_bytes(
    sensor: Sensor, camera_shape: tuple[int, ...], channels: int, brackets: int, patterns: int
) -> int:
    """Return the bytes, before compression, of brackets and of what is made of patterns."""
    bracket = prod(sensor.frame_shape(camera_shape, channels)) * sensor.frame_dtype.itemsize
    image = prod(camera_shape) * channels
    # Radiance and variance; and each pixel of each image may be a piece that the method keeps, in
    # the level's own store and in the transport.
    merged = 4 * image * np.dtype(RADIANCE).itemsize
    sums = 2 * image * np.dtype(np.float64).itemsize
    return brackets * (bracket + _BLOCK_BYTES) + patterns * (merged + _BLOCK_BYTES) + sums


def check_disk(name: str, need: int, folder: Path, present: int = 0) -> None:
    """Refuse a capture that doesn't fit on the disk, before anything is shown.

    `need` bytes are taken at most, of which those `present` in the folder are replaced. Raises
    StoreError when less is free on the folder's file system.
    """
    free = files.free_bytes(folder)
    if need - present > free:
        raise StoreError(
            f"{folder}: the capture of {name} isn't begun: it and what is made of it take up to "
            f"{shown_bytes(need)}, of which {shown_bytes(present)} are there already; "
            f"{shown_bytes(free)} are free on this file system. Make room, put the results on "
            "another disk, set capture.keep_raw to false, or choose the method's options for "
            "fewer patterns; then run again: what is captured is kept"
        )
    _log.info("%s: takes up to %s; %s are free", name, shown_bytes(need), shown_bytes(free))


def shown_bytes(count: int) -> str:
    """Show a number of bytes to three digits, such as ``629 MB``."""
    for unit, scale in (("TB", 1e12), ("GB", 1e9)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e6:.3g} MB"


def forecast(settings: Config) -> pd.DataFrame:
    """Return a row for each acquisition of a run; nothing is shown or written.

    Returns
    -------
    pandas.DataFrame
        ``scene``, ``method``; ``rays`` of the projector, ``levels``; ``patterns`` that the method
        expects, ``seconds`` on the rig and ``disk`` in bytes, before compression, that they take;
        ``most_patterns``, ``most_seconds`` and ``most_disk``, the largest of each; ``memory`` in
        bytes.

    Raises
    ------
    InputError
        When a method doesn't fit a scene's rays.
    """
    import pandas as pd

    from rfpipe.photometry import ExactSensor, sensor_from_config
    from rfpipe.stages.plan import Plan, plan_of

    rows = []
    for scene, name in settings.acquisitions:
        plan = Plan(**plan_of(settings, scene, name))
        of_scene = settings.of_scene(scene)
        capture, sensor = of_scene.capture, sensor_from_config(of_scene.camera)
        is_exact = isinstance(sensor, ExactSensor)
        references = 2 if is_exact else capture.black_frames + capture.floodlit_frames
        references += plan.asks_symmetry * SYMMETRY_FRAMES
        pictures = of_scene.verification_pictures
        looks = 2 if pictures and capture.precautions.check_interval else 0
        references += pictures + looks
        rays = plan.camera, plan.projector
        warm_up, each = 60 * capture.warm_up_minutes, capture.seconds_per_pattern
        camera = plan.camera.shape, plan.channels
        counts = {
            "": plan.method.expected_patterns(*rays, plan.options),
            "most_": plan.method.most_patterns(*rays, plan.options),
        }
        takes: dict[str, float] = {}
        for prefix, count in counts.items():
            brackets = references + capture.keep_raw * count
            takes |= {
                f"{prefix}patterns": count,
                f"{prefix}seconds": warm_up + each * (count + references),
                f"{prefix}disk": disk_bytes(sensor, *camera, brackets, count),
            }
        rows.append(
            {
                "scene": scene, "method": name,
                "rays": plan.projector.size, "levels": plan.n_levels, **takes,
                "memory": plan.method.memory_bytes(*rays, plan.channels, plan.options)
                + settings.scenes[scene].simulation_bytes,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
