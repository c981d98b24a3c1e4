"""Brightness of the lamp while an acquisition's first brackets are taken.

    g[k] = L[k] / L[0],    L[k] = sum of bracket k's radiance over the known pixels

====== ================= ====== ================================================================
symbol code              shape  meaning
====== ================= ====== ================================================================
L      total             (C,)   light of an all-on bracket
L[0]   reference         (C,)   light of level 0's picture, at the time of the first check picture
g      floodlit          (C,)   mean brightness of the all-on brackets
g      random_patterns   (n, C) brightness at each random pattern of the symmetry test
====== ================= ====== ================================================================

Most methods take level 0's picture under the all-on pattern, too. Otherwise the last all-on
brackets are the reference. `rfpipe.references.drift` estimates the brightness at later patterns.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from rfpipe.array_types import Double
from rfpipe.photometry.sensor import MergedImages
from rfpipe.references.reference_brackets import open_reference_brackets
from rfpipe.references.reference_images import ReferenceImages
from rfpipe.references.steadiness import is_smooth
from rfpipe.rigs.faults import SIGNIFICANCE
from rfpipe.storage.base import LAMP, SYMMETRY, Storage

_LAST_BRACKETS = 8
"""Number of all-on brackets whose mean is the brightness at their end."""

_log = logging.getLogger(__name__)


class InitialBrightness(NamedTuple):
    """Brightness relative to that at the first check picture.

    Attributes
    ----------
    floodlit : ndarray of float64, shape (C,)
        Mean over the all-on brackets.
    random_patterns : ndarray of float64, shape (n, C)
        At each random pattern of the symmetry test.
    is_steady : bool
        Whether the brightness is constant or drifts; if it changes from picture to picture,
        the brightness is 1 throughout.
    """

    floodlit: Double
    random_patterns: Double
    is_steady: bool

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest."""
        return {LAMP: {"floodlit": self.floodlit.tolist(), "steady": self.is_steady}}


class _Light(NamedTuple):
    """Sum of radiance over an image's known pixels, and its variance; (C,) each."""

    total: Double
    variance: Double


def measure_initial_brightness(
    storage: Storage, references: ReferenceImages, *, level_0_is_floodlit: bool
) -> InitialBrightness:
    """Estimate the brightness of the reference brackets and random patterns; log a change.

    Parameters
    ----------
    storage : Storage
        Level 0 is captured.
    references : ReferenceImages
    level_0_is_floodlit : bool
        Whether level 0 has one pattern, the all-on one.
    """
    captured = storage.read_manifest(0, "capture")
    n_random = captured.get(SYMMETRY, {}).get("symmetry_brackets", 0)
    channels = references.floodlit.shape[-1]
    ones = np.ones(channels), np.ones((n_random, channels))
    with open_reference_brackets(storage) as brackets:
        last = deque(enumerate(brackets.all_on), _LAST_BRACKETS)
        lights = [_light(references.merge(bracket, index)) for index, bracket in last]
    level_0 = _level_0_light(storage, references) if level_0_is_floodlit else None
    series = np.stack([light.total for light in (*lights, *([level_0] if level_0 else []))])
    if not (series[-1] > 0).all():
        return InitialBrightness(*ones, is_steady=True)
    if not is_smooth(series / series[-1]):
        return InitialBrightness(*ones, is_steady=False)
    end = _mean(lights)
    mean = _light(MergedImages(references.floodlit[None], references.floodlit_variance[None], 0))
    reference = level_0 or end
    end_ratio, mean_ratio = (_ratio(light, reference) for light in (end, mean))
    # from the middle of the last all-on brackets to the first picture of level 0
    span = -(len(lights) + 1) / 2, float(n_random)
    times = np.arange(n_random)
    random_patterns = [np.interp(times, span, (ratio, 1.0)) for ratio in end_ratio]
    change = float(np.abs(mean_ratio - 1).max())
    if change:
        _log.warning(
            "the lamp's light changed by %.2g %% from the all-on brackets to level 0; it is "
            "divided out", 100 * change,
        )  # fmt: skip
    at_random = np.reshape(np.stack(random_patterns, axis=1), (n_random, channels))
    return InitialBrightness(mean_ratio, at_random, is_steady=True)


def divide_floodlit(references: ReferenceImages, brightness: Double) -> ReferenceImages:
    """Divide the floodlit image by the lamp's brightness (C,)."""
    if (brightness == 1).all():
        return references
    factor = (1 / brightness).astype(np.float32)
    return replace(
        references,
        floodlit=references.floodlit * factor,
        floodlit_variance=references.floodlit_variance * factor**2,
    )


def _level_0_light(storage: Storage, references: ReferenceImages) -> _Light:
    with storage.pictures(0, "capture") as store:
        return _light(references.merge(store.read(0, 1)))


def _light(merged: MergedImages) -> _Light:
    """Light of the first of merged images, (*camera_shape, C)."""
    known = np.isfinite(merged.variance[0])
    parts = (np.where(known, image[0], 0) for image in (merged.radiance, merged.variance))
    return _Light(
        *(part.reshape(-1, part.shape[-1]).sum(axis=0, dtype=np.float64) for part in parts)
    )


def _mean(lights: list[_Light]) -> _Light:
    total = np.mean([light.total for light in lights], axis=0)
    variance = np.mean([light.variance for light in lights], axis=0)
    return _Light(total, variance / len(lights))


def _ratio(light: _Light, reference: _Light) -> Double:
    """Ratio of light to the reference, (C,); 1 where the difference may be noise."""
    ratio = light.total / reference.total
    noise = np.sqrt(light.variance + ratio**2 * reference.variance) / reference.total
    return np.where(np.abs(ratio - 1) > SIGNIFICANCE * noise, ratio, 1.0)
