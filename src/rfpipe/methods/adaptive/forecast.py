"""Forecast of the patterns of an adaptive acquisition: before it, and after each round.

Before the first picture only the target error ``t`` and the number of projector views ``v`` are
known. They don't determine the number of patterns ``n``: for one target it differs by a factor of
20 between scenes, by the kind of their light. A forecast is therefore a median and two quartiles of
the benchmark's tuning scenes, each a `PatternLaw`, and the number of all rounds and of a complete
hierarchy, which is the largest (`most_patterns`)::

    n = v c (1 % / t)^a

The number of rays and the amount of light have no visible effect on ``n``.

Once a round has been shown, its estimated error ``e`` is known as well (`remaining_patterns`).
Errors fall with a power ``p`` of the number of patterns, so that after ``n_1`` patterns the target
takes

    n = n_1 (e_1 / t)^(1 / p)

From the second round on, ``p`` is measured: ``p = log(e_0 / e_1) / log(n_1 / n_0)``
(`patterns_to_target`). Where a hierarchy follows, or would take fewer patterns,
`hierarchy_patterns` is their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.state import HIERARCHY_TOLERANCE, AdaptiveState, Phase
from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.held_out import HELD_OUT
from rfpipe.methods.multiplexed.blocks import block_levels
from rfpipe.methods.multiplexed.method import coarse_pattern_count


class PatternLaw(NamedTuple):
    """Number of patterns by target error.

    Attributes
    ----------
    patterns : float
        Patterns of a projector view for an error of 1 %.
    power : float
        Power of 1 / error by which their number grows.
    """

    patterns: float
    power: float

    def at(self, views: int, target: float) -> float:
        """Compute the number of patterns for a total error."""
        return float(views * self.patterns * (0.01 / target) ** self.power)


FIT_SECONDS_A_RAY = 0.005, 0.05
"""Processor seconds a camera ray that a hierarchy's fits take, to 1 %.

Measured on mirror_beside and right_angles at 48 x 48 (docs/performance.md).
"""

EXPECTED = PatternLaw(33.0, 0.8)
"""Median over the benchmark's tuning scenes."""

LOWER_QUARTILE, UPPER_QUARTILE = PatternLaw(20.0, 0.6), PatternLaw(60.0, 1.0)
"""A quarter of the tuning scenes take fewer patterns, a quarter more. Most of the test scenes, with
glass, mirrors and gloss among them, take more."""

SLOWEST_POWER = 0.25
"""Errors fall with a power of the number of patterns. Below this power more patterns hardly help:
half the error would take sixteen times as many."""

TYPICAL_POWER = 0.8
"""Power of the number of patterns by which errors typically fall after the first round.

With it, 31 of 36 forecasts of all patterns after the first round of the tuning scenes, and 16 of 21
after the second, are within a factor of 1.5; on the test scenes 8 of 13 and 6 of 8.
"""

HIERARCHY_RAYS = PatternLaw(65.0, 0.8)
"""Patterns of single rays of the hierarchy, below its coarser levels, by target error."""

# Largest number of patterns of a hierarchy, over the expected number.
_HIERARCHY_MARGIN = 5.0


def hierarchy_patterns(projector: RayDomain, target: float) -> float:
    """Compute the expected number of patterns of a hierarchy for a total error."""
    tolerance = HIERARCHY_TOLERANCE * target
    of_rays = HIERARCHY_RAYS.at(1, target)
    return coarse_pattern_count(block_levels(projector), tolerance) + of_rays


def most_hierarchy_patterns(projector: RayDomain, target: float) -> int:
    """Bound the number of patterns of a hierarchy: it ends at one a ray."""
    return min(round(_HIERARCHY_MARGIN * hierarchy_patterns(projector, target)), projector.size)


def most_patterns(
    projector: RayDomain, random_patterns: int, dense_patterns: int, options: ErrorOptions
) -> int:
    """Bound the number of patterns of all phases.

    Parameters
    ----------
    projector : RayDomain
    random_patterns, dense_patterns : int
        Largest numbers of random patterns of all rounds before a hierarchy, and after one that
        doesn't suit the light.
    options : ErrorOptions
    """
    hierarchy = most_hierarchy_patterns(projector, options.total_target) + dense_patterns
    total = 1 + len(HELD_OUT) + random_patterns + hierarchy
    return min(total, options.patterns or total)


def error_power(state: AdaptiveState, errors: Sequence[float]) -> float:
    """Compute the power of the number of patterns by which errors fall.

    `errors` are those after the last rounds, at least two.
    """
    patterns = sum(row["patterns"] for row in state.rows[1 - len(errors) :])
    before = state.patterns_shown - patterns
    return float(np.log(errors[0] / errors[-1]) / np.log(state.patterns_shown / before))


def patterns_to_target(state: AdaptiveState) -> float:
    """Extrapolate the number of patterns that the target still takes.

    The power law goes through the last round and the one two rounds before, or the one before if
    there are only two rounds. The number is infinite if errors hardly fall, and 0 after a single
    round or if the target is met.
    """
    excess = state.excess[-3:]
    if len(excess) < 2 or excess[-1] <= 1:
        return 0.0
    power = error_power(state, excess)
    if power < SLOWEST_POWER:
        return np.inf
    return float(state.patterns_shown * (excess[-1] ** (1 / power) - 1))


def remaining_patterns(state: AdaptiveState) -> int:
    """Forecast the number of patterns that an acquisition still shows, after a round.

    Parameters
    ----------
    state : AdaptiveState
        State whose next round is chosen.
    """
    coming, shown = state.next_round, state.patterns_shown
    if coming is None:
        return 0
    target = state.options.total_target
    hierarchy = hierarchy_patterns(state.projector, target)
    if coming.phase is Phase.HIERARCHY:
        of_hierarchy = sum(state.rows[level]["patterns"] for level in state.hierarchy_levels)
        remaining = hierarchy - of_hierarchy
    elif not state.estimates:
        remaining = EXPECTED.at(state.projector.views, target) - shown
    else:
        typical = shown * (state.excess[-1] ** (1 / TYPICAL_POWER) - 1)
        largest = hierarchy if state.allows_hierarchy else state.projector.size
        remaining = min(max(typical, patterns_to_target(state)), largest)
    limit = state.options.patterns - shown if state.options.patterns else np.inf
    return round(float(min(max(remaining, coming.held_out + coming.count, 1), limit)))


def hierarchy_hours(camera_rays: int) -> tuple[float, float]:
    """Forecast the least and the largest processor time of a hierarchy's fits, in hours."""
    least, most = (seconds * camera_rays / 3600 for seconds in FIT_SECONDS_A_RAY)
    return least, most
