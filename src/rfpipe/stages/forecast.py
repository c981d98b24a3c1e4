"""What a run will take, before the lamp is switched on."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rfpipe.photometry import ExactSensor, sensor_from_config
from rfpipe.stages.disk import disk_bytes
from rfpipe.stages.plan import Plan, plan_of
from rfpipe.stages.watch import look_count, looks_every
from rfpipe.units import SYMMETRY_FRAMES

if TYPE_CHECKING:
    import pandas as pd

    from rfpipe.config import Config


def forecast(settings: Config) -> pd.DataFrame:
    """Return a row for each acquisition of a run; nothing is shown or written.

    Returns
    -------
    pandas.DataFrame
        ``scene``, ``method``; ``rays`` of the projector, ``levels``; ``patterns`` that the method
        expects, ``seconds`` on the rig, ``disk`` and ``memory`` in bytes, before compression; and
        ``most`` patterns, of a scene without any structure, with their ``most_seconds``.

    Raises
    ------
    InputError
        When a method doesn't fit a scene's rays.
    """
    import pandas as pd

    rows = []
    for scene, name in settings.acquisitions:
        plan = Plan(**plan_of(settings, scene, name))
        of_scene = settings.of_scene(scene)
        capture, sensor = of_scene.capture, sensor_from_config(of_scene.camera)
        is_exact = isinstance(sensor, ExactSensor)
        references = 2 if is_exact else capture.black_frames + capture.floodlit_frames
        references += plan.asks_symmetry * SYMMETRY_FRAMES
        pictures = of_scene.verification_pictures
        references += pictures + 2 if pictures else 0
        every = [capture.drift_patterns]
        if capture.watch != "off":
            every.append(looks_every(capture.looks, plan.method.needs_coaxial_rig))
        rays = plan.camera, plan.projector
        expected = plan.method.expected_patterns(*rays, plan.options)
        most = plan.method.most_patterns(*rays, plan.options)
        besides, besides_most = (
            references + sum(look_count(patterns, each) for each in every if each)
            for patterns in (expected, most)
        )
        warm_up, each = 60 * capture.warm_up_minutes, capture.seconds_per_pattern
        brackets = besides + capture.keep_raw * expected
        camera = plan.camera.shape, plan.channels
        rows.append(
            {
                "scene": scene, "method": name,
                "rays": plan.projector.size, "levels": plan.n_levels,
                "patterns": expected, "seconds": warm_up + each * (expected + besides),
                "disk": disk_bytes(sensor, *camera, brackets, expected),
                "memory": plan.method.memory_bytes(*rays, plan.channels, plan.options)
                + settings.scenes[scene].simulation_bytes,
                "most": most, "most_seconds": warm_up + each * (most + besides_most),
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
