"""Fit of the footprint model: direct light D and indirect light S in turn.

Neither part of ``T = D + diag(f) L S R^T diag(g)`` is known at first:

1. *First footprints* are found by a matched filter that suppresses indirect light (`search`).
   Rough ones are enough: R and g only need to know where the camera sees each projector pixel.
2. *Indirect light* is fitted with functions from coarse to fine. The weights of D are marginalised,
   so that errors of D do not matter (`scales`).
3. *Better footprints* are searched for, and their weights are fitted, in the pictures minus
   indirect light (`search`).
4. Steps 2 and 3 are repeated, unless the footprints of an earlier round were the starting point.
5. S and then the weights are fitted a last time, with fixed candidates and functions: to the sum of
   the channels, and to each channel.

With several projector views each camera pixel has footprints on every view, and each pattern lights
one view. In a light field of coaxial pairs, ``D = D^T`` (`reciprocity`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from math import log2
from typing import NamedTuple

import numpy as np

from rfpipe.array_types import Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import Candidates, StoredCandidates
from rfpipe.methods.footprints.indirect import (
    BEST,
    GOOD,
    ROUGH,
    Accuracy,
    FitData,
    IndirectLight,
    fit_cores,
    fit_data,
    fit_gains,
)
from rfpipe.methods.footprints.model import ChannelModel, FittedChannels
from rfpipe.methods.footprints.pictures import floodlit_by_all
from rfpipe.methods.footprints.problem import FitLimits, PicturesByView, Problem, make_problem
from rfpipe.methods.footprints.reciprocity import (
    fit_reciprocal_weights,
    symmetrized,
    with_transposed,
)
from rfpipe.methods.footprints.scales import ScaleAccuracies, fit_indirect_light
from rfpipe.methods.footprints.search import (
    FAINT,
    better_footprints,
    first_footprints,
    fit_weights_of_views,
)
from rfpipe.methods.footprints.weights import marginal_precision
from rfpipe.transport.multiscale import coarsest_scale

# Prior standard deviations of weights, as fractions of the weight and of the floodlit image: in the
# last fit, and for the mean of D and its transpose.
_LAST_PRIOR, _RECIPROCAL_PRIOR = (1.0, 0.02), (0.05, 0.003)

# Before a further search S may be rough. In the last fit of a light field, more iterations at each
# scale took longer and increased errors by 10 % (2 x 3 views of 36 x 44), since few rays take part;
# with one view they decreased errors by 4 % (48 x 48).
_BETWEEN_SEARCHES = ScaleAccuracies(ROUGH, ROUGH)
_LAST_OF_IMAGE, _LAST_OF_LIGHT_FIELD = ScaleAccuracies(GOOD, BEST), ScaleAccuracies(ROUGH, BEST)


class _LastFit(NamedTuple):
    """Accuracy of S in the last fit, and fits of S and D in turn where ``D = D^T``."""

    accuracy: Accuracy
    turns: int


# The fit of a channel starts from that of the channels' sum.
_SUM, _CHANNEL = _LastFit(BEST, 2), _LastFit(GOOD, 1)


def fit_model(
    camera: RayDomain,
    projector: RayDomain,
    grey: PicturesByView,
    channels: Iterable[PicturesByView],
    previous: StoredCandidates | None = None,
    limits: FitLimits | None = None,
) -> FittedChannels:
    """Fit the model to pictures.

    Parameters
    ----------
    camera, projector : RayDomain
    grey : tuple of ViewPictures
        Sum of the channels, for each projector view.
    channels : iterable of tuple of ViewPictures
        Each channel; empty if there is one. Each is fitted before the next is read.
    previous : StoredCandidates, optional
        `FittedChannels.grey` of an earlier fit.
    limits : FitLimits, optional
        By default at most 131,072 camera rays, and 4,096 with several projector views.
    """
    problem = make_problem(camera, projector, grey, limits)
    footprints = previous if previous is not None else first_footprints(problem)
    last = _LAST_OF_IMAGE if projector.views == 1 else _LAST_OF_LIGHT_FIELD
    for accuracies in [last] if previous is not None else [_BETWEEN_SEARCHES, last]:
        light = fit_indirect_light(problem, footprints, accuracies)
        footprints = better_footprints(problem, footprints, light)
    footprints = _prepare_last_fit(grey, footprints, light)
    combined = _fit_parts(grey, footprints, light, problem.camera_rays, _SUM)
    fitted = tuple(_fit_channel(problem, pictures, combined) for pictures in channels)
    return FittedChannels(combined.footprints, fitted or (combined,))


def solution_count(projector: RayDomain, channels: int, *, is_first: bool) -> int:
    """Return the largest number of fits of S in `fit_model`, for displays of progress."""
    scales = round(log2(coarsest_scale(projector.image_shape)))
    searches = 2 if is_first else 1
    last_fits = 1 + (channels if channels > 1 else 0)
    return searches * (3 + 2 * scales) + last_fits * min(projector.views, 2)


def _prepare_last_fit(
    pictures: PicturesByView, footprints: StoredCandidates, light: IndirectLight
) -> StoredCandidates:
    """Drop faint candidates, and set the prior variances for the last fits.

    Where ``D = D^T``, candidates are completed by the transposed ones, and weights are fitted.
    """
    footprints = StoredCandidates.of(
        part.above(FAINT, view.floodlit).with_variance(view.floodlit, *_LAST_PRIOR)
        for view, part in zip(pictures, footprints, strict=True)
    )
    if not light.basis.mapping.shared_rays:
        return footprints
    return fit_weights_of_views(pictures, with_transposed(footprints), light.in_pictures(pictures))


def _fit_parts(
    pictures: PicturesByView,
    footprints: StoredCandidates,
    light: IndirectLight,
    camera_rays: Index | None,
    last: _LastFit,
) -> ChannelModel:
    """Fit S, then the weights of D, with fixed candidates and functions."""
    if light.basis.mapping.shared_rays:
        return _fit_reciprocal_parts(pictures, footprints, light, camera_rays, last.turns)
    data = fit_data(pictures, footprints, camera_rays)
    light = fit_gains(fit_cores(light, data, light.learned_deviations(), last.accuracy), data)
    footprints = fit_weights_of_views(pictures, footprints, light.in_pictures(pictures))
    return ChannelModel(footprints, light)


def _fit_reciprocal_parts(
    pictures: PicturesByView,
    footprints: StoredCandidates,
    light: IndirectLight,
    camera_rays: Index | None,
    turns: int,
) -> ChannelModel:
    """Fit S, and weights near ``D = D^T``, in turn.

    The mean of D and its transpose is known so well that S is fitted to the pictures minus direct
    light, with a small prior variance for errors of the weights.
    """
    for _ in range(turns):
        data = _data_without_direct_light(pictures, symmetrized(footprints), camera_rays)
        light = fit_cores(light, data, light.learned_deviations(), GOOD)
        indirect = light.in_pictures(pictures)
        footprints = StoredCandidates.of(fit_reciprocal_weights(footprints, pictures, indirect))
    return ChannelModel(footprints, light)


def _data_without_direct_light(
    pictures: PicturesByView, footprints: Iterable[Candidates], camera_rays: Index | None
) -> FitData:
    """Subtract direct light from the pictures of a fit of S.

    The prior variance of weights allows for errors of `footprints`, the mean of D and its
    transpose.
    """
    indirect, precisions = [], []
    for view, on_view in zip(pictures, footprints, strict=True):
        in_fit, part = view.at(camera_rays), on_view.at(camera_rays)
        prior = part.with_variance(in_fit.floodlit, *_RECIPROCAL_PRIOR)
        precisions.append(marginal_precision(prior, in_fit))
        direct = part.matrix() @ in_fit.patterns
        indirect.append(replace(in_fit, radiance=in_fit.radiance - direct))
    return FitData(tuple(indirect), tuple(precisions), camera_rays)


def _fit_channel(
    problem: Problem, pictures: PicturesByView, combined: ChannelModel
) -> ChannelModel:
    """Fit a channel, starting from the model of the channels' sum, scaled to its brightness.

    The share of the channel, (M,), is its floodlit image over the floodlit image of the sum.
    """
    floodlit, grey = floodlit_by_all(pictures), floodlit_by_all(problem.grey)
    share = np.divide(floodlit, grey, out=np.zeros_like(floodlit), where=grey > 0)
    if not any(view.has_light() for view in pictures):
        share[:] = 0
    footprints, light = combined.footprints, combined.indirect
    footprints = StoredCandidates.of(part.scaled(share) for part in footprints)
    mapping = light.basis.mapping
    typical = max(float(np.median(share[share > 0])) if (share > 0).any() else 0.0, 0.0)
    visibility = mapping.visibility
    projector_share = visibility * (mapping.means @ share) + (1 - visibility) * np.float32(typical)
    # f and g are both multiplied by the share, but light by one share only: S is divided by it
    light = IndirectLight(
        light.basis,
        light.f * share,
        (light.g * projector_share).astype(np.float32),
        np.ones_like(light.camera_gain),
        np.ones_like(light.projector_gain),
        light.core_parts / np.float32(typical or 1.0),
    )
    if not share.any():
        return ChannelModel(footprints, light)
    fitted = _fit_parts(pictures, footprints, light, problem.camera_rays, _CHANNEL)
    # the candidates are those of the sum, and are stored once for all channels
    weights = fitted.footprints.weights
    return replace(fitted, footprints=replace(combined.footprints, weights=weights))
