"""Forecast of a run: number of patterns, time, memory and disk space of each acquisition."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.units import RADIANCE, SYMMETRY_BRACKETS

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config
    from rfpipe.photometry import Sensor

_BLOCK_BYTES = 4096
"""Block size of file systems; a file takes whole blocks."""


def disk_bytes(
    sensor: Sensor, camera_shape: tuple[int, ...], channels: int, brackets: int, patterns: int
) -> int:
    """Return the uncompressed size of brackets and of the results of patterns, in bytes."""
    bracket = prod(sensor.frame_shape(camera_shape, channels)) * sensor.frame_dtype.itemsize
    image = prod(camera_shape) * channels
    # Radiance and variance; and a method may keep an entry for each pixel of each image, in the
    # level's store and in the transport.
    merged = 4 * image * np.dtype(RADIANCE).itemsize
    sums = 2 * image * np.dtype(np.float64).itemsize
    return brackets * (bracket + _BLOCK_BYTES) + patterns * (merged + _BLOCK_BYTES) + sums


def forecast(settings: Config) -> pd.DataFrame:
    """Return the forecast of a run, without displaying or writing anything.

    Returns
    -------
    pandas.DataFrame
        A row for each acquisition: ``scene``, ``method``; number of ``rays`` of the projector;
        expected number of ``patterns``, their ``seconds`` on the rig and uncompressed size on
        ``disk`` in bytes; ``max_patterns``, ``max_seconds`` and ``max_disk``, their upper limits;
        ``memory`` in bytes.

    Raises
    ------
    InputError
        If a method doesn't fit a scene's rays.
    """
    import pandas as pd

    from rfpipe.photometry import ExactSensor, sensor_from_config
    from rfpipe.stages.plan import Plan
    from rfpipe.stages.settings import plan_settings

    rows = []
    for scene, name in settings.acquisitions:
        plan = Plan.of(**plan_settings(settings, scene, name))
        scene_settings = settings.of_scene(scene)
        capture, sensor = scene_settings.capture, sensor_from_config(scene_settings.camera)
        is_exact = isinstance(sensor, ExactSensor)
        n_further = 2 if is_exact else capture.all_off_brackets + capture.all_on_brackets
        n_further += plan.measures_symmetry * SYMMETRY_BRACKETS
        n_verification = scene_settings.verification_pictures
        has_check_pictures = n_verification > 0 and capture.precautions.check_interval > 0
        # a check picture is taken before and after the verification pictures
        # a check picture before the first and after the last verification picture
        n_further += n_verification + 2 * has_check_pictures
        expected = plan.description.forecast(
            plan.camera, plan.projector, plan.channels, plan.options
        )
        warm_up = 60 * capture.warm_up_minutes
        camera = plan.camera.shape, plan.channels
        counts = {"": expected.patterns, "max_": expected.max_patterns}
        costs: dict[str, float] = {}
        for prefix, count in counts.items():
            brackets = n_further + capture.keep_raw * count
            costs |= {
                f"{prefix}patterns": count,
                f"{prefix}seconds": warm_up + capture.seconds_per_pattern * (count + n_further),
                f"{prefix}disk": disk_bytes(sensor, *camera, brackets, count),
            }
        rows.append(
            {
                "scene": scene, "method": name,
                "rays": plan.projector.size, **costs,
                "memory": expected.memory_bytes + settings.scenes[scene].simulation_bytes,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
