"""Stage: the factors that make a level's images add up to the floodlit image [B.2].

Methods read the merged images multiplied by these factors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.methods import Method
from rfpipe.patterns import Schedule
from rfpipe.photometry.normalize import LevelGain, apply, level_gain
from rfpipe.provenance import fingerprint
from rfpipe.references.image_sum import ImageSum
from rfpipe.references.reference_images import read_floodlit
from rfpipe.stages.context import Acquisition
from rfpipe.stages.merge import read_level_sum
from rfpipe.stages.schedule import read_schedule
from rfpipe.storage.base import REFERENCE_IMAGES, SUMS, Storage
from rfpipe.units import NormalizationMode


@dataclass(frozen=True)
class NormalizedImages:
    """The images of a level, scaled to add up to the floodlit image as they are read (B.2).

    ``store.read(first, last)`` returns radiance and variance, (B, 2, *camera_shape, C).
    """

    schedule: Schedule
    store: Any
    normalization: LevelGain

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Read normalized radiance and its variance of patterns ``first:last``."""
        images = self.store.read(first, min(last, self.schedule.count))
        return apply(images[:, 0], images[:, 1], self.normalization)


def masked_rays(floodlit_variance: Float) -> NDArray[np.bool_]:
    """Return the camera rays of infinite variance in any channel, bool (*camera_shape)."""
    return np.asarray(np.isinf(floodlit_variance).any(axis=-1))


def light_of_unlit_rays(method: Method[Any], state: Any, schedule: Schedule) -> Float | None:
    """Predict the light of the rays that a level leaves unlit, (*camera_shape, C).

    None where the level lights every ray that can send light.
    """
    if schedule.complete or schedule.pattern_of_ray is None:
        return None
    return method.transport(state).relight(schedule.pattern_of_ray < 0)


def normalize_level(
    schedule: Schedule,
    level_sum: ImageSum,
    floodlit: tuple[Float, Float],
    unlit_light: Float | None,
    mode: NormalizationMode,
    significance: float,
) -> LevelGain:
    """Compare the sum of a level's images with the floodlit image and its variance (thesis B.2).

    The predicted light of rays that the level leaves unlit, `unlit_light`, is first subtracted from
    the floodlit image. A pixel that has most of its light from such rays keeps a gain of 1, since
    its difference is mostly noise. `significance` is in standard deviations. Images are float32,
    (*camera_shape, C).
    """
    radiance, variance = floodlit
    is_scaled = mode != "none" and (schedule.complete or unlit_light is not None)
    expected = radiance if unlit_light is None else radiance - unlit_light
    normalization = level_gain(
        expected, level_sum.radiance, level_sum.variance, mode, is_scaled, significance, variance
    )
    if unlit_light is None:
        return normalization
    covered = normalization.covered & (unlit_light < expected)
    gain = np.where(covered, normalization.gain, np.float32(1))
    return LevelGain(gain, covered, mode)


def run(acquisition: Acquisition, level: int) -> None:
    """Compare a level's images with the floodlit image; write the factors and their manifest.

    The images aren't read, since the merge has added them up, nor written a second time: readers
    multiply them by the factors.
    """
    plan, storage = acquisition.plan, acquisition.storage
    mode, significance = acquisition.settings.normalization, plan.options.noise_significance
    planned = storage.read_manifest(level, "schedule")
    inputs = {
        "merge": storage.read_manifest(level, "merge")[SUMS]["digest"],
        "references": storage.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"],
        "schedule": [planned["pattern_digest"], planned["complete"]],
        "mode": mode,
        "noise_significance": significance,
        "code": acquisition.settings.code,
    }
    # the state matters only where the level leaves rays unlit
    needs_state = not planned["complete"] and mode != "none"
    if needs_state:
        inputs |= {"plan": plan.describe(), "refine": acquisition.refined_digests(level)}
    inputs_fingerprint = fingerprint(inputs)
    if storage.current_manifest(level, "normalize", inputs_fingerprint):
        return
    schedule, unlit_light = read_schedule(storage, level), None
    if needs_state:
        state = acquisition.state_before(level)
        unlit_light = light_of_unlit_rays(plan.method, state, schedule)
    factors = normalize_level(
        schedule, read_level_sum(storage, level), read_floodlit(storage), unlit_light, mode,
        significance,
    )  # fmt: skip
    facts = {
        "stage": "normalize",
        "level": level,
        "mode": mode,
        "units": {"gain": "1", "covered": "whether scaled"},
        "covered_fraction": float(np.mean(factors.covered)),
    }
    arrays = {"gain": factors.gain, "covered": factors.covered}
    storage.write(level, "normalize", inputs_fingerprint, arrays, facts)


def read_normalization(storage: Storage, level: int) -> LevelGain:
    """Read the factors of a level; errors as `Storage.read`."""
    arrays, attributes = storage.read(level, "normalize")
    return LevelGain(arrays["gain"], arrays["covered"], attributes["facts"]["mode"])
