"""Reference brackets: how many all-off and all-on brackets an acquisition takes, and their reading.

The floodlit image is the mean of the all-on brackets. Its noise becomes the noise of the direct
light of every relit picture; the noise of the all-off brackets is part of all pictures. An
acquisition begins with few reference brackets. The merge of these predicts how noisy one more is,
and the acquisition takes as many as make one more bracket worth one more pattern.

The error e of a method that shows p patterns falls with a power of p. With n brackets of the
relative noise h, the target t is met by

    e^2 + h^2 / n = t^2,    e ~ p^-a

The sum n + p is smallest where both derivatives of the left side are equal:

    2 a e^2 / p = h^2 / n^2,    which gives    n^2 - r n - r p / (2 a) = 0,    r = (h / t)^2

======  =====================  =====================================================================
symbol  name in the code       meaning and unit
======  =====================  =====================================================================
``t``   `target_error`         error of relit pictures at which the method stops, of their norm
``p``   `expected_patterns`    patterns that it is expected to show
``n``   the result             all-on, or all-off, brackets
``h``   `all_on`, `all_off`    noise of one bracket, relative to the norm of the floodlit image
``a``   `SLOWEST_POWER`        power of p by which e falls at least while a method continues
======  =====================  =====================================================================

The slowest power is used, since near a target errors often fall slowly: a method that lacks a tenth
of its target then shows many patterns that a few all-on brackets would have saved.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import ceil, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools
from rfpipe.methods.adaptive.forecast import SLOWEST_POWER
from rfpipe.photometry.camera import are_saturated
from rfpipe.photometry.sensor import Sensor
from rfpipe.storage.base import (
    MORE_REFERENCE_BRACKETS,
    REFERENCE_BRACKETS,
    Facts,
    Manifest,
    Storage,
    StoredPictures,
)

FIRST_ALL_OFF, FIRST_ALL_ON = 2, 4
"""Brackets with which an acquisition begins: hot pixels are found by the variance of two all-off
ones, and changes of lamp or camera by the all-on ones."""

MOST_ALL_OFF, MOST_ALL_ON = 8, 64
"""Largest numbers of brackets."""

REFERENCE_PARTS = (REFERENCE_BRACKETS, MORE_REFERENCE_BRACKETS)
"""Stores of the brackets, and their keys in the manifest of level 0's capture."""

_TINY = float(np.finfo(np.float64).tiny)


class ReferenceCounts(NamedTuple):
    """Numbers of all-off and of all-on brackets of a set."""

    all_off: int
    all_on: int

    @property
    def is_off(self) -> Bools:
        """Mask of the all-off brackets of the set, in the order of capture, bool (brackets,).

        Half of the all-off ones come last, so that a change of the room's light shows in them.
        """
        last = self.all_off // 2
        return np.repeat([True, False, True], [self.all_off - last, self.all_on, last])


def counts_of_set(facts: Facts) -> ReferenceCounts:
    """Return the numbers of brackets of a set, from its entry in a manifest."""
    return ReferenceCounts(facts["all_off_brackets"], facts["all_on_brackets"])


@dataclass(frozen=True)
class ReferenceNoise:
    """Noise of one all-off and of one all-on bracket, relative to the floodlit image's norm."""

    all_off: float
    all_on: float

    @classmethod
    def of(cls, sensor: Sensor, all_off: NDArray[Any], all_on: NDArray[Any]) -> ReferenceNoise:
        """Predict the noise by the sensor's model, from brackets (K, E, ...) of either kind.

        Without light, the noise is infinite.
        """
        black = all_off.mean(axis=0, dtype=np.float64).astype(np.float32)
        merge = sensor.bracket_merge(black, len(all_off))
        dark, floodlit = merge(all_off[:1]), merge(all_on)
        variance = floodlit.variance.mean(axis=0, dtype=np.float64)
        radiance = floodlit.radiance.mean(axis=0, dtype=np.float64)
        saturated = are_saturated(floodlit.radiance, floodlit.variance).any(axis=0)
        light = float(np.square(radiance[~saturated]).sum())
        noise = float(variance[~saturated].sum())
        squared_norm = max(light - noise / len(all_on), _TINY)
        all_off_noise = float(dark.variance[0][~saturated].sum(dtype=np.float64))
        return cls(sqrt(all_off_noise / squared_norm), sqrt(noise / squared_norm))

    def needed(self, target_error: float, expected_patterns: int) -> ReferenceCounts:
        """Compute the numbers at which one more bracket is worth one more pattern."""
        all_off = _needed(self.all_off / target_error, expected_patterns, MOST_ALL_OFF)
        all_on = _needed(self.all_on / target_error, expected_patterns, MOST_ALL_ON)
        return ReferenceCounts(max(all_off, FIRST_ALL_OFF), max(all_on, FIRST_ALL_ON))


def _needed(ratio: float, expected_patterns: int, largest: int) -> int:
    """Solve for n; `ratio` is the noise of a bracket over the target."""
    r = min(ratio, 1e6) ** 2
    return min(largest, ceil((r + sqrt(r**2 + 2 * r * expected_patterns / SLOWEST_POWER)) / 2))


def reference_counts(captured: Manifest) -> ReferenceCounts:
    """Return the numbers of all reference brackets of an acquisition.

    `captured` is the manifest of level 0's capture.
    """
    sets = [counts_of_set(captured[part]) for part in REFERENCE_PARTS if part in captured]
    return ReferenceCounts(*map(sum, zip(*sets, strict=True)))


@dataclass(frozen=True)
class StoredBrackets:
    """Reference brackets of one kind, (1, E, ...) each, read whenever they are iterated over.

    Attributes
    ----------
    stores : tuple of (StoredPictures, list of int)
        Stores, and the indices of the brackets in each.
    """

    stores: tuple[tuple[StoredPictures, list[int]], ...]

    def __iter__(self) -> Iterator[NDArray[Any]]:
        """Read one bracket after the other."""
        for store, indices in self.stores:
            for index in indices:
                yield store.read(index, index + 1)


class ReferenceBrackets(NamedTuple):
    """The reference brackets of an acquisition."""

    all_off: StoredBrackets
    all_on: StoredBrackets


@contextmanager
def open_reference_brackets(storage: Storage) -> Iterator[ReferenceBrackets]:
    """Open the reference brackets of level 0, which is captured; errors as `Storage.pictures`."""
    captured = storage.read_manifest(0, "capture")
    parts = [part for part in REFERENCE_PARTS if part in captured]
    with ExitStack() as stack:
        stores = [stack.enter_context(storage.pictures(0, "capture", part)) for part in parts]
        kinds = [counts_of_set(captured[part]).is_off for part in parts]
        all_off, all_on = (
            StoredBrackets(
                tuple(
                    (store, np.flatnonzero(is_off == kind).tolist())
                    for store, is_off in zip(stores, kinds, strict=True)
                )
            )
            for kind in (True, False)
        )
        yield ReferenceBrackets(all_off, all_on)
