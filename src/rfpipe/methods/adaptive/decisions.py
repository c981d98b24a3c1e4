"""What follows a round: the one place where acquisitions in rounds decide.

A table has conditions and what follows; the first that holds counts, and where none does the
acquisition goes on as before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.methods.adaptive.state import AdaptiveState
from rfpipe.methods.base import ErrorOptions


@dataclass(frozen=True)
class Thresholds:
    """What decisions depend on, by data of the benchmark's open scenes.

    Attributes
    ----------
    stalled : float
        A round of smooth light that leaves more than this of the error before it has shown that
        more won't help.
    slowest : float
        Errors fall with a power of the patterns; where they fall by a lesser one than this, more
        patterns hardly help: half the error would take sixteen times as many.
    least : tuple of int and float
        Patterns of a round, at least: so many, and this share of all before it.
    ample : float
        Patterns of a round over those that errors as they fall ask for.
    indirect : float
        Error of indirect light over that in total.
    nearly : float
        An error of so many times the target is nearly there.
    noise : float
        An error of so many times the floodlit image's noise is mostly noise.
    symmetric, dual : tuple of float
        Patterns a level of the block tree for an error of a hundredth, and the power of the error
        by which they grow.
    """

    stalled: float = 0.85
    slowest: float = 0.25
    least: tuple[int, float] = (6, 0.1)
    ample: float = 1.1
    indirect: float = 6.0
    nearly: float = 1.2
    noise: float = 1.5
    symmetric: tuple[float, float] = (30.0, 0.55)
    dual: tuple[float, float] = (45.0, 0.75)


_AT = Thresholds()

PATTERNS = (30.0, 0.8)
"""Patterns of a view for an error of a hundredth, and the power by which they grow.

They do not depend on the number of rays. On the open scenes of ``docs/benchmark`` acquisitions took
1.1 times as many in the median, half of them 0.75 to 1.75 times, one in ten more than 7 times; on
the held-out scenes, of which most have mirrors, glass or hair, 3.6 times, half of them 0.8 to 7.
"""


@dataclass(frozen=True)
class Way:
    """What an acquisition in rounds goes by.

    Attributes
    ----------
    law : tuple of float
        Of its hierarchy, see `Thresholds`.
    blocks_first : bool
        Whether rounds of random blocks come before the hierarchy, too.
    measured : bool
        Whether the model's direct light is the floodlit image's, with all of its noise.
    lost : float
        Error after the first round from which on the model is the wrong one. Of smooth light it is
        2 to 8 % on diffuse and glossy scenes, 10 to 20 % where there are mirrors or glass; of
        footprints 3 to 5 % on diffuse scenes, 8 to 11 % on caustics.
    tolerance : float
        Of the hierarchy, over the target. Mean errors are 1 to 3 tolerances of symmetric
        photography, 2 to 6 of dual photography; what all pictures tell halves them.
    """

    law: tuple[float, float]
    blocks_first: bool
    measured: bool
    lost: float
    tolerance: float


COAXIAL = Way(_AT.symmetric, blocks_first=True, measured=True, lost=0.1, tolerance=0.6)
ASIDE = Way(_AT.dual, blocks_first=False, measured=False, lost=0.07, tolerance=0.2)


def what_follows(
    state: AdaptiveState, way: Way, just: str, slot: str, depth: int
) -> tuple[str, str]:
    """Tell what follows a round of patterns, and why.

    `just` is what the last level was for, `slot` what the next one is for, `depth` the levels of
    the block tree.
    """
    limit = state.options.patterns
    free = not limit and state.inner is None
    over = slot != just
    errors = [estimate.error for estimate in state.estimates]
    stalled = len(errors) > 2 and errors[-1] > _AT.stalled * errors[-2]
    slow = way.blocks_first and (stalled if just == "model" else over)
    costly = going_on(state) > hierarchy_cost(state, depth, way.law)
    last = just == ("residual" if way.blocks_first else "model")
    # what ends about at the target is not given up for what begins with nothing: on fields of
    # 9 x 12 x 16 rays, 680 more patterns of dual photography gained nothing
    nearly = state.excess[-1] <= _AT.nearly
    noise = way.measured and errors[-1] <= _AT.noise * state.pictures.noise
    lost = len(errors) == 1 and errors[0] > way.lost
    # beyond a hierarchy there is nothing else, but for brute force
    hopeless = state.inner is not None and going_on(state) > state.projector.size
    table = (
        (state.reached, "done", ""),
        (bool(limit) and state.shown >= limit, "done", "all patterns are shown that there may be"),
        ((over or slow) and noise, "done", "it is the noise of the floodlit image"),
        (free and (state.unfit or lost), "hierarchy", "the model doesn't fit the light"),
        ((over or costly) and last and nearly, "done", "it is nearly there"),
        (free and last and (over or costly), "hierarchy", "more rounds would take more patterns"),
        # of the same patterns, blocks tell more of what smooth light leaves than probes do
        (
            way.blocks_first and just == "model" and (over or slow or state.residual is not None),
            "residual",
            "smooth light is not all there is",
        ),
        (over, "done", "all rounds are shown"),
        (hopeless, "done", "more rounds would take more patterns than brute force"),
    )
    return next(((what, why) for holds, what, why in table if holds), (state.following, ""))


def going_on(state: AdaptiveState) -> float:
    """Return how many more patterns the target takes as errors fall so far.

    Infinity where they hardly fall any more; 0 after one round, or where the target is reached.
    """
    errors = state.excess[-3:]
    if len(errors) < 2 or errors[-1] <= 1:
        return 0.0
    patterns = [row["patterns"] for row in state.rows if row["patterns"]]
    before = state.shown - sum(patterns[1 - len(errors) :])
    power = np.log(errors[0] / errors[-1]) / np.log(state.shown / before)
    if power < _AT.slowest:
        return np.inf
    return float(state.shown * (errors[-1] ** (1 / power) - 1))


def next_round(state: AdaptiveState, most: int) -> int:
    """Return how many patterns the next round needs of at most so many: about what is missing."""
    missing = going_on(state)
    least = max(_AT.least[0], round(_AT.least[1] * state.shown))
    count = max(least, round(min(_AT.ample * missing, most))) if missing else most
    views = state.projector.views  # may be lit in turn, each as often as all others
    return min(most, -(-count // views) * views)


def hierarchy_cost(state: AdaptiveState, depth: int, law: tuple[float, float]) -> float:
    """Return how many patterns a hierarchy of so many levels takes for the target."""
    return hierarchy_patterns(target_of(state), depth, law)


def hierarchy_patterns(target: float, depth: int, law: tuple[float, float]) -> float:
    """Number of patterns that a hierarchy of `depth` levels takes for a total error."""
    a_level, power = law
    return float(a_level * depth * (0.01 / target) ** power)


def target_of(state: AdaptiveState) -> float:
    """Return the error that a hierarchy has to have in total."""
    return total_error(state.options)


def total_error(options: ErrorOptions) -> float:
    """Total error that meets both targets; the error of indirect light is six times as large."""
    indirect = options.target_indirect or np.inf
    return float(min(options.target_error, indirect / _AT.indirect))
