"""What a run will take, before the lamp is switched on: patterns, time, memory and disk."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.units import RADIANCE, SYMMETRY_FRAMES

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config
    from rfpipe.photometry import Sensor

_BLOCK_BYTES = 4096  # a file takes whole blocks of its file system


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


def forecast(settings: Config) -> pd.DataFrame:
    """Return a row for each acquisition of a run; nothing is shown or written.

    Returns
    -------
    pandas.DataFrame
        ``scene``, ``method``; ``rays`` of the projector; ``patterns`` that the method
        expects, ``seconds`` on the rig and ``disk`` in bytes, before compression, that they take;
        ``max_patterns``, ``max_seconds`` and ``max_disk``, the largest of each; ``memory`` in
        bytes.

    Raises
    ------
    InputError
        When a method doesn't fit a scene's rays.
    """
    import pandas as pd

    from rfpipe.photometry import ExactSensor, sensor_from_config
    from rfpipe.stages.plan import Plan
    from rfpipe.stages.settings import plan_settings

    rows = []
    for scene, name in settings.acquisitions:
        plan = Plan.of(**plan_settings(settings, scene, name))
        of_scene = settings.of_scene(scene)
        capture, sensor = of_scene.capture, sensor_from_config(of_scene.camera)
        is_exact = isinstance(sensor, ExactSensor)
        references = 2 if is_exact else capture.black_frames + capture.floodlit_frames
        references += plan.measures_symmetry * SYMMETRY_FRAMES
        pictures = of_scene.verification_pictures
        looks = 2 if pictures and capture.precautions.check_interval else 0
        references += pictures + looks
        expected = plan.description.forecast(
            plan.camera, plan.projector, plan.channels, plan.options
        )
        warm_up, each = 60 * capture.warm_up_minutes, capture.seconds_per_pattern
        camera = plan.camera.shape, plan.channels
        counts = {"": expected.patterns, "max_": expected.max_patterns}
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
                "rays": plan.projector.size, **takes,
                "memory": expected.memory_bytes + settings.scenes[scene].simulation_bytes,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
