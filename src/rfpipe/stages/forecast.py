"""Forecast of a run: pictures on the rig, time, memory and disk space of each acquisition."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

import numpy as np

from rfpipe.references.check_pictures import check_picture_count
from rfpipe.references.reference_brackets import (
    FIRST_ALL_OFF,
    FIRST_ALL_ON,
    MOST_ALL_OFF,
    MOST_ALL_ON,
    ReferenceCounts,
    ReferenceNoise,
)
from rfpipe.storage.picture_counts import PictureCounts
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY, RADIANCE, SYMMETRY_BRACKETS

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config
    from rfpipe.config.capture import CaptureConfig
    from rfpipe.photometry import Sensor
    from rfpipe.stages.plan import Plan

_BLOCK_BYTES = 4096
"""Block size of file systems; a file takes whole blocks."""

_SAMPLE_SHAPE = (16, 16)
"""Shape of the simulated floodlit image by which the reference brackets are forecast."""


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
        expected numbers of ``patterns``, of ``pictures`` on the rig for all purposes and of their
        exposures, ``frames``; the ``seconds`` of these pictures and of the warm-up, and their
        uncompressed size on ``disk`` in bytes; ``lower_pictures`` and ``upper_pictures``, between
        which half of the benchmark's tuning scenes are; ``max_patterns``, ``max_pictures``,
        ``max_frames``, ``max_seconds`` and ``max_disk``, their upper limits; ``memory`` in bytes;
        the path of the ``prior``, None without one, and ``pictures_without_prior``. With a prior
        all numbers but the upper limits and the last one are those of an unchanged scene.

    Raises
    ------
    InputError
        If a method doesn't fit a scene's rays or its prior.
    """
    import pandas as pd

    from rfpipe.stages.plan import Plan
    from rfpipe.stages.settings import plan_settings

    rows = []
    for scene, name in settings.acquisitions:
        plan = Plan.of(**plan_settings(settings, scene, name))
        scene_settings = settings.of_scene(scene)
        expected = plan.forecast()
        largest = _costs(scene_settings, plan, expected.max_patterns, is_largest=True)
        lower, upper = (
            _costs(scene_settings, plan, patterns)["pictures"]
            for patterns in expected.quartiles or (expected.patterns, expected.patterns)
        )
        rows.append(
            {
                "scene": scene, "method": name, "rays": plan.projector.size,
                **_costs(scene_settings, plan, expected.patterns),
                "lower_pictures": lower, "upper_pictures": upper,
                **{f"max_{key}": value for key, value in largest.items()},
                "prior": None if plan.prior is None else plan.prior.path,
                "pictures_without_prior": _costs(
                    scene_settings, plan.without_prior, plan.without_prior.expected_patterns
                )["pictures"],
                "memory": expected.memory_bytes + settings.scenes[scene].simulation_bytes,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def _costs(
    settings: Config, plan: Plan, patterns: int, *, is_largest: bool = False
) -> dict[str, float]:
    """Return the cost of an acquisition of a number of patterns; see `forecast`."""
    from rfpipe.photometry import sensor_from_config

    capture, sensor = settings.capture, sensor_from_config(settings.camera)
    pictures = expected_pictures(settings, plan, patterns, is_largest=is_largest).total
    stored = pictures - (0 if capture.keep_raw else patterns)
    return {
        "patterns": patterns,
        "pictures": pictures,
        "frames": pictures * len(sensor.exposures),
        "seconds": 60 * capture.warm_up_minutes + capture.seconds_per_pattern * pictures,
        "disk": disk_bytes(sensor, plan.camera.shape, plan.channels, stored, patterns),
    }


def expected_pictures(
    settings: Config, plan: Plan, patterns: int, *, is_largest: bool = False
) -> PictureCounts:
    """Return the pictures on the rig of an acquisition that takes a number of patterns.

    Parameters
    ----------
    settings : Config
        Settings of the scene, see `Config.of_scene`.
    plan : Plan
    patterns : int
    is_largest : bool
        Whether to count the largest number of reference brackets, as of a scene with little light.
    """
    from rfpipe.photometry import sensor_from_config

    capture, verification = settings.capture, settings.verification_pictures
    sensor = sensor_from_config(settings.camera)
    as_needed = ReferenceCounts(MOST_ALL_OFF, MOST_ALL_ON)
    if not is_largest:
        as_needed = _expected_references(sensor, plan)
    interval = capture.precautions.check_interval if capture.watch != "off" else 0
    checks = 0
    if interval:
        # a level and the verification have a check picture more than intervals
        checks = check_picture_count(patterns, interval) + 2 * (verification > 0)
    return PictureCounts(
        references=sum(_reference_counts(capture, sensor, as_needed)),
        symmetry=plan.measures_symmetry * SYMMETRY_BRACKETS,
        patterns=patterns,
        checks=checks,
        verification=verification,
    )


def _expected_references(sensor: Sensor, plan: Plan) -> ReferenceCounts:
    """Compute the reference brackets of a scene whose radiance is spread evenly from 0 to 1."""
    from rfpipe.photometry import CameraModel

    if not isinstance(sensor, CameraModel):
        return ReferenceCounts(FIRST_ALL_OFF, FIRST_ALL_ON)
    ramp = np.linspace(0, 1, prod(_SAMPLE_SHAPE), dtype=np.float32).reshape(*_SAMPLE_SHAPE, 1)
    floodlit = np.repeat(ramp, plan.channels, axis=-1)
    all_off, all_on = (
        np.stack([sensor.expose(image, 0, (kind, index)) for index in range(count)])
        for kind, image, count in (
            (BLACK_LEVEL_KEY, 0 * floodlit, FIRST_ALL_OFF),
            (FLOODLIT_KEY, floodlit, FIRST_ALL_ON),
        )
    )
    noise = ReferenceNoise.of(sensor, all_off, all_on)
    return noise.needed(plan.target_error, plan.expected_patterns)


def _reference_counts(
    capture: CaptureConfig, sensor: Sensor, as_needed: ReferenceCounts
) -> ReferenceCounts:
    """Return the numbers of all-off and all-on brackets, those of the settings if given."""
    from rfpipe.photometry import ExactSensor

    if isinstance(sensor, ExactSensor):
        return ReferenceCounts(1, 1)
    fixed = capture.precautions
    return ReferenceCounts(
        capture.all_off_brackets or fixed.all_off_brackets or as_needed.all_off,
        capture.all_on_brackets or fixed.all_on_brackets or as_needed.all_on,
    )
