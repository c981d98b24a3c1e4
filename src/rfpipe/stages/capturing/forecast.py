"""What a run will take, told before the lamp is switched on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from rfpipe.photometry import ExactSensor, Sensor, sensor_from_config
from rfpipe.stages.capturing.disk import DiskNeed
from rfpipe.stages.capturing.drift import item_count
from rfpipe.stages.capturing.moves import every_of
from rfpipe.stages.capturing.taken import Taken, proportion
from rfpipe.stages.plan import Plan, plan_of

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["Forecast", "Need", "forecast", "forecast_of"]

# Rays to which the seconds of an acquisition, for each pattern and ray, are those of another.
_LIKE_SECONDS = 4.0


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
        As this acquisition took before; else by `Method.expected_patterns`, in the proportion in
        which others came out.
    most : Need
        Of a scene without any structure. It may be beyond reach; each level is checked again.
    known : {"taken", "alike", "guess"}
        What `expected` is known from.
    here : float or None
        Seconds with all processing where the rig is simulated, as far as others tell.
    """

    scene: str
    method: str
    rays: int
    levels: int
    expected: Need
    most: Need
    known: Literal["taken", "alike", "guess"] = "guess"
    here: float | None = None


def forecast(settings: Config, sensor: Sensor, taken: Sequence[Taken] = ()) -> list[Forecast]:
    """Tell what each acquisition of a run will take; nothing is shown or written.

    Parameters
    ----------
    settings : Config
    sensor : Sensor
        The run's camera's; scenes may have another.
    taken : sequence of Taken
        Acquisitions to learn from.

    Raises
    ------
    InputError
        When a method doesn't fit a scene's rays.
    """
    return [forecast_of(settings, sensor, *one, taken) for one in settings.acquisitions]


def forecast_of(
    settings: Config, sensor: Sensor, scene: str, name: str, taken: Sequence[Taken] = ()
) -> Forecast:
    """Tell what one acquisition, a scene by a method's section, will take; as `forecast`."""
    plan = Plan(**plan_of(settings, scene, name))
    rays = plan.camera, plan.projector, plan.options
    most = plan.method.most_patterns(*rays)
    patterns, known = _expected(plan, scene, taken, most)
    own = settings.of_scene(scene)
    camera = sensor if own.camera == settings.camera else sensor_from_config(own.camera)
    expected, at_most = (_need(own, camera, plan, count) for count in (patterns, most))
    here = _here(plan, scene, patterns, taken) if settings.capture.rig == "simulated" else None
    about = scene, name, plan.projector.size, plan.n_levels
    return Forecast(*about, expected, at_most, known, here)


def _expected(
    plan: Plan, scene: str, taken: Sequence[Taken], most: int
) -> tuple[int, Literal["taken", "alike", "guess"]]:
    """Return the patterns that are expected, and what they are known from."""
    for one in taken:
        if one.is_of(scene, plan):
            return one.patterns, "taken"
    expected = plan.method.expected_patterns(plan.camera, plan.projector, plan.options)
    share = proportion(taken, plan)
    if share is None:
        return expected, "guess"
    return min(max(1, round(expected * share)), most), "alike"


def _here(plan: Plan, scene: str, patterns: int, taken: Sequence[Taken]) -> float | None:
    """Return the seconds of a simulated acquisition, by the same one or by others."""
    same = [one.seconds for one in taken if one.is_of(scene, plan) and one.seconds is not None]
    if same:
        return same[0]
    # what starting takes counts for much in small ones
    alike = [
        one for one in taken if one.method == plan.method.name and one.is_near(plan, _LIKE_SECONDS)
    ]
    each = [one.seconds_a_sample for one in alike if one.seconds_a_sample is not None]
    if not each:
        return None
    return patterns * plan.camera.size * plan.channels * sum(each) / len(each)


def _need(settings: Config, sensor: Sensor, plan: Plan, patterns: int) -> Need:
    capture = settings.capture
    references = capture.black_frames + capture.floodlit_frames
    if isinstance(sensor, ExactSensor):
        references = 2
    references += plan.asks_symmetry * capture.symmetry_frames
    looks = item_count(patterns, capture.drift_patterns) if capture.drift_patterns else 0
    if capture.watch != "off":
        every = every_of(capture.looks, tells=plan.method.needs_coaxial_rig)
        looks += item_count(patterns, every) if every else 0
    if settings.verification_pictures:
        looks += settings.verification_pictures + 2
    brackets = patterns + references + looks
    seconds = 60 * capture.warm_up_minutes + brackets * capture.seconds_per_pattern
    kept = references + looks + capture.keep_raw * patterns
    disk = DiskNeed.of(sensor, plan.camera.shape, plan.channels, kept, patterns)
    return Need(patterns, seconds, disk)
