"""What a run will take, told before the lamp is switched on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rfpipe.photometry import ExactSensor, Sensor
from rfpipe.stages.capturing.disk import DiskNeed
from rfpipe.stages.capturing.drift import item_count
from rfpipe.stages.plan import Plan, plan_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["Forecast", "Need", "forecast"]


@dataclass(frozen=True)
class Need:
    """What an acquisition takes if it takes so many patterns.

    Attributes
    ----------
    patterns : int
        Of the method. References and looks of the drift watch come on top.
    seconds : float
        On the rig: for all brackets and the lamp's warming up.
    disk : DiskNeed
    """

    patterns: int
    seconds: float
    disk: DiskNeed


@dataclass(frozen=True)
class Forecast:
    """What one acquisition takes.

    Attributes
    ----------
    scene, method : str
    rays, levels : int
        Rays of the projector, and levels of their block tree.
    expected : Need
        By the counts that the thesis reports for scenes of this many levels.
    most : Need
        Of a scene without any structure. It may be beyond reach; each level is checked again.
    """

    scene: str
    method: str
    rays: int
    levels: int
    expected: Need
    most: Need


def forecast(settings: Config, sensor: Sensor) -> list[Forecast]:
    """Tell what each acquisition of a run will take; nothing is shown or written.

    Parameters
    ----------
    settings : Config
    sensor : Sensor
        The camera's.

    Raises
    ------
    InputError
        When a method doesn't fit a scene's rays.
    """
    found = []
    for scene, name in settings.acquisitions:
        plan = Plan(**plan_of(settings, scene, name))
        of_method = plan.method.expected_patterns, plan.method.most_patterns
        needs = (
            _need(settings, sensor, plan, patterns(plan.camera, plan.projector, plan.options))
            for patterns in of_method
        )
        found.append(Forecast(scene, name, plan.projector.size, plan.n_levels, *needs))
    return found


def _need(settings: Config, sensor: Sensor, plan: Plan, patterns: int) -> Need:
    capture = settings.capture
    references = capture.black_frames + capture.floodlit_frames
    if isinstance(sensor, ExactSensor):
        references = 2
    references += plan.asks_symmetry * capture.symmetry_frames
    looks = item_count(patterns, capture.drift_patterns) if capture.drift_patterns else 0
    brackets = patterns + references + looks
    seconds = 60 * capture.warm_up_minutes + brackets * capture.seconds_per_pattern
    kept = references + looks + capture.keep_raw * patterns
    disk = DiskNeed.of(sensor, plan.camera.shape, plan.channels, kept, patterns)
    return Need(patterns, seconds, disk)
