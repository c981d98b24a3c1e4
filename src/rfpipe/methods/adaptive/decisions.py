"""What follows a round: the one place where acquisitions in rounds decide.

Each acquisition has a table of conditions and what follows; the first that holds counts, and where
none does the acquisition goes on as before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from rfpipe.methods.adaptive.rounds import AdaptiveState

# A round of smooth light that leaves more than this of the error before it has shown that more
# won't help. Errors of rounds of blocks and of footprints should fall with these powers of the
# patterns: noise alone falls with the root.
_STALLED, _STALLED_BLOCKS, _STALLED_FOOTPRINTS = 0.85, 0.2, 0.25
# Errors after the first and the second round from which on footprints are the wrong model: of
# diffuse scenes they are 4 and 2 %, of a bottle and its caustics 8 to 11 and 13 %.
_UNFIT = (0.07, 0.05)


def smooth_light(state: AdaptiveState, just: str, slot: str, depth: int) -> str:
    """Tell what follows a round of smooth light, or of what it leaves.

    `just` is what the last level was for, `slot` what the next one is for, `depth` the levels of
    the block tree.
    """
    estimate, limit = state.estimates[-1], state.options.patterns
    # the first estimate knows neither strip nor spots: it bounds the error if nothing is indirect
    reached = state.reached and (state.all_held or estimate.indirect <= state.options.target_error)
    before_hierarchy = just == "residual" and state.inner is None
    share = _STALLED
    if just == "residual":
        share = (1 - state.rows[-1]["patterns"] / state.shown) ** _STALLED_BLOCKS
    slow = state.leaves(share)
    # blocks that hardly help may still reach the target before a hierarchy would
    nearly = before_hierarchy and _cheaper(state, _STALLED_BLOCKS, depth)
    costly = before_hierarchy and _costly(state, depth)
    stalled = slot != just or costly or (slow and not nearly)
    # a model that leaves so much of the indirect light unexplained is the wrong one; the first
    # round's probes are few
    unexplained = estimate.dark > (0.5 if len(state.estimates) == 1 else 0.25) * estimate.indirect
    lost = just == "model" and unexplained
    table = (
        (reached or (limit and state.shown >= limit), "done"),
        ((stalled or slow) and estimate.is_noise, "done"),
        (
            not limit and state.inner is None and (lost or (stalled and just == "residual")),
            "hierarchy",
        ),
        # of the same patterns, blocks tell more of what smooth light leaves than probes do
        (just == "model" and (stalled or state.residual is not None), "residual"),
        (stalled, "done"),
    )
    return next((following for holds, following in table if holds), state.following)


def is_unfit(state: AdaptiveState) -> bool:
    """Tell whether footprints have turned out to be the wrong model."""
    rounds = len(state.estimates)
    too_large = rounds <= len(_UNFIT) and state.estimates[-1].error > _UNFIT[rounds - 1]
    return state.unfit or too_large


def footprints(state: AdaptiveState, rounds: int) -> str:
    """Tell what follows a round of footprints, of so many there may be."""
    estimate, limit = state.estimates[-1], state.options.patterns
    part = 1 - state.rows[-1]["patterns"] / state.shown
    stalled = state.level > rounds or state.leaves(part**_STALLED_FOOTPRINTS)
    # a model that has stalled about at the target is not given up for dual photography, which
    # begins with nothing: on fields of 9 x 12 x 16 rays, 680 more patterns gained nothing
    nearly = not state.unfit and estimate.error <= 1.2 * state.options.target_error
    table = (
        ((state.all_held and state.reached) or (limit and state.shown >= limit), "done"),
        (
            not limit and state.all_held and (state.unfit or stalled) and not (stalled and nearly),
            "hierarchy",
        ),
        (stalled, "done"),
    )
    return next((following for holds, following in table if holds), state.following)


def hierarchy(state: AdaptiveState, depth: int) -> str:
    """Tell what follows a level of a hierarchy of so many, or its held-out pictures."""
    target = state.options.target_error or 0.0
    if state.estimates and state.inner.level < depth and state.estimates[-1].error > target:
        return "hierarchy"
    return "done" if state.all_held else "held"


def _costly(state: AdaptiveState, depth: int) -> bool:
    """Tell whether the target would take more blocks than a hierarchy, as errors fall so far."""
    errors = [estimate.error for estimate in state.estimates[-3:]]
    # the first estimate is of other held-out pictures
    if len(state.estimates) < 4:
        return False
    patterns = [row["patterns"] for row in state.rows if row["patterns"]]
    before = state.shown - sum(patterns[-2:])
    power = _STALLED_BLOCKS
    if errors[0] > errors[-1] > 0:
        power = max(power, np.log(errors[0] / errors[-1]) / np.log(state.shown / before))
    return not _cheaper(state, power, depth)


def _cheaper(state: AdaptiveState, power: float, depth: int) -> bool:
    """Tell whether blocks take fewer patterns than a hierarchy, with errors falling so.

    Symmetric photography has an error of a hundredth by 27 patterns a level on the open scenes of
    the benchmark (13 to 41), and they grow by the power .57 of the error.
    """
    target = state.options.target_error
    more = state.shown * ((state.estimates[-1].error / target) ** (1 / power) - 1)
    return bool(more <= 27 * depth * (0.01 / target) ** 0.57)
