"""Stage: the factors that make a level's images add up to the floodlit image [B.2].

A method reads the images merged, then normalized on the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Method
from rfpipe.patterns import Schedule
from rfpipe.photometry.normalize import Mode, Normalization, apply, level_gain
from rfpipe.provenance import fingerprint
from rfpipe.references.image_sum import ImageSum
from rfpipe.references.reference_images import read_floodlit
from rfpipe.stages.merge import read_level_sum
from rfpipe.stages.plan import Plan
from rfpipe.stages.schedule import read_schedule
from rfpipe.storage.files import REFERENCE_IMAGES, SUMS, AcquisitionFolder
from rfpipe.transport import Transport

Float = NDArray[np.float32]


@dataclass(frozen=True)
class NormalizedImages:
    """The images of a level, scaled to add up to the floodlit image as they are read (B.2).

    ``frames.read(first, last)`` returns radiance and variance, (B, 2, *camera_shape, C); None for a
    level without patterns.
    """

    schedule: Schedule
    frames: Any
    normalization: Normalization

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return normalized radiance and its variance of patterns ``first:last``."""
        if self.frames is None:
            nothing = np.empty((0, *self.normalization.gain.shape), np.float32)
            return nothing, nothing
        images = self.frames.read(first, min(last, self.schedule.count))
        return apply(images[:, 0], images[:, 1], self.normalization)


def masked_rays(floodlit_variance: Float) -> NDArray[np.bool_]:
    """Return the camera rays that no image knows, (*camera_shape), of a variance with channels."""
    return np.asarray(np.isinf(floodlit_variance).any(axis=-1))


def known_light(method: Method[Any], state: Any, schedule: Schedule) -> Float | None:
    """Predict the light of the rays that a level no longer lights, (*camera_shape, C).

    None where the level lights every ray that can send light.
    """
    if schedule.complete or not schedule.count or schedule.pattern_of_ray is None:
        return None
    transport: Transport = method.known(state)
    return transport.relight(schedule.pattern_of_ray < 0)


def normalize_level(
    schedule: Schedule,
    level_sum: ImageSum,
    floodlit: tuple[Float, Float],
    known: Float | None,
    mode: Mode,
    significance: float,
) -> Normalization:
    """Compare the sum of a level's images with the floodlit image and its variance (thesis B.2).

    Where the level leaves rays dark whose light is `known` already, that light is taken off the
    floodlit image first. A pixel that has most of its light from such rays is left as it is: the
    difference would be all noise. `significance` is in standard deviations. Images are float32,
    (*camera_shape, C).
    """
    radiance, spread = floodlit
    wanted = mode != "none" and (schedule.complete or known is not None)
    expected = radiance if known is None else radiance - known
    found = level_gain(
        expected, level_sum.radiance, level_sum.variance, mode, wanted, significance, spread
    )
    if known is None:
        return found
    covered = found.covered & (known < expected)
    gain = np.where(covered, found.gain, np.float32(1))
    return Normalization(gain, covered, mode)


def run(plan: Plan, folder: AcquisitionFolder, level: int, *, mode: Mode, code: str) -> None:
    """Compare a level's images with the floodlit image; write the factors and their manifest.

    The images aren't read here, since the merge has added them up, nor written a second time: who
    reads them applies the factors on the way. `code` is the digest of the code behind the stage.
    """
    plan.settle(folder, aloud=level == 0)
    planned = folder.read_manifest(level, "schedule")
    made_of = {
        "merge": folder.read_manifest(level, "merge")[SUMS]["digest"],
        "references": folder.read_manifest(0, "merge")[REFERENCE_IMAGES]["digest"],
        "schedule": [planned["shown"], planned["complete"]],
        "mode": mode,
        "noise_significance": plan.options.noise_significance,
        "code": code,
    }
    # What is known already counts only where the level leaves rays dark.
    if not planned["complete"] and mode != "none":
        made_of |= {"plan": plan.describe(), "refine": folder.refined_above(level)}
    made_from = fingerprint(made_of)
    if folder.standing(level, "normalize", made_from):
        return
    schedule = read_schedule(folder, level)
    known = None
    if "refine" in made_of:
        known = known_light(plan.method, plan.state_before(folder, level), schedule)
    factors = normalize_level(
        schedule, read_level_sum(folder, level), read_floodlit(folder), known, mode,
        plan.options.noise_significance,
    )  # fmt: skip
    facts = {
        "stage": "normalize",
        "level": level,
        "mode": mode,
        "units": {"gain": "1", "covered": "whether scaled"},
        "covered_fraction": float(np.mean(factors.covered)),
    }
    arrays = {"gain": factors.gain, "covered": factors.covered}
    folder.write(level, "normalize", made_from, arrays, facts)


def read_normalization(folder: AcquisitionFolder, level: int) -> Normalization:
    """Read the factors of a level; errors as `AcquisitionFolder.read`."""
    arrays, attributes = folder.read(level, "normalize")
    return Normalization(arrays["gain"], arrays["covered"], attributes["facts"]["mode"])
