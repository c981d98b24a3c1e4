"""Judgement of a prior: the transport of an earlier acquisition with the same rig."""

from __future__ import annotations

from dataclasses import asdict

from rfpipe.methods.error_estimate import Estimate
from rfpipe.methods.held_out import HELD_OUT_OF_PRIOR
from rfpipe.transport.base import Transport, last_estimate

PATTERNS_WITH_PRIOR = 1 + HELD_OUT_OF_PRIOR
"""Patterns after which an acquisition of an unchanged scene ends: floodlit and held-out ones."""

USEFUL_PRIOR = 0.05
"""Estimated error of a prior above which the acquisition continues without it. The first round of a
model leaves about as much; a prior with an error of 10 % cost more patterns than none."""

# Ratio of a prior's new estimate to its own up to which the scene may be unchanged: two standard
# deviations of the ratio, where estimates from 6 and 3 pictures have 15 and 21 %.
_AGREEMENT = 1.5


def pooled_estimate(estimate: Estimate, prior: Transport) -> Estimate:
    """Average the estimate from three held-out pictures with the prior's own, where they agree.

    The error of a prior of an unchanged scene is also known from the six held-out pictures of its
    acquisition, which therefore have twice the weight.
    """
    earlier_error = last_estimate(prior.level_rows).get("estimated_error", 0.0)
    if not 0 < estimate.error <= _AGREEMENT * earlier_error:
        return estimate
    factor = (2 * earlier_error / estimate.error + 1) / 3
    return Estimate(**{kind: factor * error for kind, error in asdict(estimate).items()})
