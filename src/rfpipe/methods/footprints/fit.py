"""Fit of the footprint model: direct light D and indirect light S in turn.

Neither part of ``T = D + diag(f) L S R^T diag(g)`` is known at first:

1. *First footprints* are found by a matched filter that suppresses indirect light (`geometry`).
   Rough ones are enough: R and g only need to know where the camera sees each projector pixel.
2. *Indirect light* is fitted with functions from coarse to fine. The weights of D are marginalised,
   so that errors of D do not matter (`indirect`).
3. *Better footprints* are searched for, and their weights are fitted, in the pictures minus
   indirect light (`geometry`, `weights`).
4. Steps 2 and 3 are repeated, unless the footprints of an earlier round were the starting point.
5. S and then the weights are fitted a last time, with fixed candidates and functions: to the sum of
   the channels, and to each channel.

With several projector views each camera pixel has footprints on every view, and each pattern lights
one view. In a light field of coaxial pairs, ``D = D^T`` (`reciprocity`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import log2
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import (
    Candidates,
    join_pixels,
    join_views,
    on_view,
    split_views,
)
from rfpipe.methods.footprints.charts import Chart, chart_from_view
from rfpipe.methods.footprints.functions import (
    CameraToProjector,
    IndirectBasis,
    camera_factor,
    camera_to_projector,
    identity_map,
    projector_factor,
)
from rfpipe.methods.footprints.geometry import first_candidates, refined_candidates
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
    misfit,
)
from rfpipe.methods.footprints.matching import Boxes, boxes_of
from rfpipe.methods.footprints.model import ChannelModel, FittedChannels
from rfpipe.methods.footprints.pictures import (
    IndirectPictures,
    ViewPictures,
    floodlit_by_all,
)
from rfpipe.methods.footprints.reciprocity import (
    fit_reciprocal_weights,
    is_symmetric,
    symmetrized,
    with_transposed,
)
from rfpipe.methods.footprints.weights import fit_weights, fit_weights_of_part
from rfpipe.methods.images import beyond_noise
from rfpipe.methods.smooth_light import coarse_to_fine
from rfpipe.provenance import generator
from rfpipe.transport.multiscale import cells, coarsest_scale

if TYPE_CHECKING:
    from scipy.sparse import csr_array

PicturesByView = tuple[ViewPictures, ...]
"""Pictures of one channel, or of the channels' sum, for each projector view."""

# Seed, and default largest numbers, of the camera rays in the fit of indirect light: with several
# projector views, and with one.
_SEED, _LIGHT_FIELD_RAYS, _IMAGE_RAYS = 2006, 4096, 2**17
# Candidates below this fraction of the floodlit image are dropped between searches.
_FAINT = 0.005
# Prior standard deviations of weights, as fractions of the weight and of the floodlit image: in the
# last fit, and for the mean of D and its transpose.
_LAST_PRIOR, _RECIPROCAL_PRIOR = (1.0, 0.02), (0.05, 0.003)
# Finer functions are added where the error exceeds this fraction of the floodlit image.
_ALLOWED_ERROR = 0.004


class _LastFit(NamedTuple):
    """Accuracy of S in the last fit, and fits of S and D in turn where ``D = D^T``."""

    accuracy: Accuracy
    turns: int


# The fit of a channel starts from that of the channels' sum.
_SUM, _CHANNEL = _LastFit(BEST, 2), _LastFit(GOOD, 1)


@dataclass(frozen=True)
class FitLimits:
    """Limits of the fits of indirect light.

    Attributes
    ----------
    camera_rays : int
        Largest number of camera rays; a random subset is used if there are more.
    core_parts : int
        Largest number of unknowns of S, two for each pair of functions.
    """

    camera_rays: int
    core_parts: int = 1_500_000


@dataclass(frozen=True)
class _Problem:
    """Rig, pictures of the channels' sum, and limits of the fits.

    Attributes
    ----------
    camera, projector : RayDomain
    grey : tuple of ViewPictures
        One for each projector view.
    boxes : list of Boxes
        One for each projector view.
    camera_rays : ndarray of int64, optional
        Rays in the fits of indirect light, ascending; None for all.
    largest_part_count : int
        `FitLimits.core_parts`.
    """

    camera: RayDomain
    projector: RayDomain
    grey: PicturesByView
    boxes: list[Boxes]
    camera_rays: Index | None
    largest_part_count: int


def fit_model(
    camera: RayDomain,
    projector: RayDomain,
    grey: PicturesByView,
    channels: Iterable[PicturesByView],
    previous: Candidates | None = None,
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
    previous : Candidates, optional
        `FittedChannels.grey` of an earlier fit.
    limits : FitLimits, optional
        By default at most 131,072 camera rays, and 4,096 with several projector views.
    """
    problem = _problem(camera, projector, grey, limits)
    footprints = previous if previous is not None else _first_footprints(problem)
    for _ in range(1 if previous is not None else 2):
        light = _fit_indirect(problem, footprints)
        footprints = _search_footprints(problem, footprints, light)
    footprints = _prepare_last_fit(grey, footprints)
    combined = _fit_parts(grey, footprints, light, problem.camera_rays, _SUM)
    fitted = tuple(_fit_channel(problem, pictures, combined) for pictures in channels)
    return FittedChannels(combined.footprints, fitted or (combined,))


def solution_count(projector: RayDomain, channels: int, *, is_first: bool) -> int:
    """Return the largest number of fits of S in `fit_model`, for displays of progress."""
    scales = round(log2(coarsest_scale(projector.image_shape)))
    searches = 2 if is_first else 1
    last_fits = 1 + (channels if channels > 1 else 0)
    return searches * (3 + 2 * scales) + last_fits * min(projector.views, 2)


def _problem(
    camera: RayDomain, projector: RayDomain, grey: PicturesByView, limits: FitLimits | None
) -> _Problem:
    view = RayDomain(projector.image_shape)
    boxes = []
    for pictures in grey:
        lit_count = max(1.0, float(pictures.lit_pixels.sum()) / camera.views)
        # projector pixels that a lit camera pixel spans along each axis, approximately
        pixels_across = float(np.sqrt(view.size / lit_count))
        boxes.append(boxes_of(view, pixels_across))
    limits = limits or FitLimits(_LIGHT_FIELD_RAYS if len(grey) > 1 else _IMAGE_RAYS)
    camera_rays = None
    if camera.size > limits.camera_rays:
        order = generator(_SEED, camera.size).permutation(camera.size)
        camera_rays = np.sort(order[: limits.camera_rays])
    return _Problem(camera, projector, grey, boxes, camera_rays, limits.core_parts)


def _first_footprints(problem: _Problem) -> Candidates:
    views = []
    for pictures, boxes in zip(problem.grey, problem.boxes, strict=True):
        floodlit = pictures.floodlit
        # only the rays in the fit of indirect light need the candidates without light
        parts = [
            _without_faint(problem, part, floodlit, 0.0, pixels)
            for pixels, part in first_candidates(pictures, problem.camera, boxes)
        ]
        views.append(join_pixels(parts))
    return join_views(views)


def _search_footprints(
    problem: _Problem, footprints: Candidates, light: IndirectLight
) -> Candidates:
    """Search for footprints in the pictures minus indirect light, and fit their weights."""
    grey, searched = problem.grey, []
    views = zip(
        grey, split_views(footprints, len(grey)), light.in_pictures(grey), problem.boxes,
        strict=True,
    )  # fmt: skip
    for pictures, part, in_pictures, boxes in views:
        refined, floodlit = [], pictures.floodlit
        search = refined_candidates(pictures, part, in_pictures, problem.camera, boxes)
        for pixels, candidates in search:
            fitted = fit_weights_of_part(candidates, pictures.at(pixels), in_pictures[pixels])
            # only the rays in the fit of indirect light need the faint candidates
            refined.append(_without_faint(problem, fitted, floodlit, _FAINT, pixels))
        searched.append(join_pixels(refined))
    footprints = join_views(searched)
    if not light.basis.mapping.shared_rays:
        return footprints
    return _fit_weights_of_views(grey, with_transposed(footprints), light.in_pictures(grey))


def _without_faint(
    problem: _Problem, candidates: Candidates, floodlit: Float, fraction: float, pixels: slice
) -> Candidates:
    """Drop weights of at most a fraction of the floodlit image, except of the rays in the fit.

    `candidates` belong to the camera pixels `pixels`, `floodlit` has all of them.
    """
    rays = problem.camera_rays
    if rays is None:
        return candidates
    exempt = rays[slice(*np.searchsorted(rays, [pixels.start, pixels.stop]))] - pixels.start
    return candidates.above(fraction, floodlit[pixels], exempt)


def _prepare_last_fit(pictures: PicturesByView, footprints: Candidates) -> Candidates:
    """Drop faint candidates, and set the prior variances for the last fits."""
    parts = zip(pictures, split_views(footprints, len(pictures)), strict=True)
    return join_views(
        [
            part.above(_FAINT, view.floodlit).with_variance(view.floodlit, *_LAST_PRIOR)
            for view, part in parts
        ]
    )


def _fit_parts(
    pictures: PicturesByView,
    footprints: Candidates,
    light: IndirectLight,
    camera_rays: Index | None,
    last: _LastFit,
) -> ChannelModel:
    """Fit S, then the weights of D, with fixed candidates and functions."""
    if light.basis.mapping.shared_rays:
        return _fit_reciprocal_parts(pictures, footprints, light, camera_rays, last.turns)
    data = fit_data(pictures, footprints, camera_rays)
    light = fit_gains(fit_cores(light, data, light.learned_deviations(), last.accuracy), data)
    footprints = _fit_weights_of_views(pictures, footprints, light.in_pictures(pictures))
    return ChannelModel(footprints, light)


def _fit_reciprocal_parts(
    pictures: PicturesByView,
    footprints: Candidates,
    light: IndirectLight,
    camera_rays: Index | None,
    turns: int,
) -> ChannelModel:
    """Fit weights near ``D = D^T``, and S, in turn.

    The mean of D and its transpose is known so well that S is fitted to the pictures minus direct
    light, with a small prior variance for errors of the weights.
    """
    footprints = with_transposed(footprints)
    footprints = _fit_weights_of_views(pictures, footprints, light.in_pictures(pictures))
    for _ in range(turns):
        footprints = fit_reciprocal_weights(footprints, pictures, light.in_pictures(pictures))
        views = list(
            zip(pictures, split_views(symmetrized(footprints), len(pictures)), strict=True)
        )
        prior = [part.with_variance(view.floodlit, *_RECIPROCAL_PRIOR) for view, part in views]
        data = fit_data(pictures, join_views(prior), camera_rays)
        residual = tuple(
            replace(view, radiance=view.radiance - part.at(camera_rays).matrix() @ view.patterns)
            for view, (_, part) in zip(data.pictures, views, strict=True)
        )
        data = replace(data, pictures=residual)
        light = fit_cores(light, data, light.learned_deviations(), GOOD)
    footprints = fit_reciprocal_weights(footprints, pictures, light.in_pictures(pictures))
    return ChannelModel(footprints, light)


def _fit_weights_of_views(
    pictures: PicturesByView, footprints: Candidates, indirect: Iterable[IndirectPictures]
) -> Candidates:
    views = zip(split_views(footprints, len(pictures)), pictures, indirect, strict=True)
    return join_views([fit_weights(part, view, in_view) for part, view, in_view in views])


def _fit_channel(
    problem: _Problem, pictures: PicturesByView, combined: ChannelModel
) -> ChannelModel:
    """Fit a channel, starting from the model of the channels' sum, scaled to its brightness.

    The share of the channel, (M,), is its floodlit image over the floodlit image of the sum.
    """
    floodlit, grey = floodlit_by_all(pictures), floodlit_by_all(problem.grey)
    share = np.divide(floodlit, grey, out=np.zeros_like(floodlit), where=grey > 0)
    if not any(view.has_light() for view in pictures):
        share[:] = 0
    footprints, light = combined.footprints, combined.indirect
    candidate_share = share[footprints.camera_pixels]
    footprints = replace(
        footprints,
        variance=footprints.variance * np.square(candidate_share),
        weights=footprints.weights * candidate_share,
    )
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
    return _fit_parts(pictures, footprints, light, problem.camera_rays, _CHANNEL)


def _fit_indirect(problem: _Problem, footprints: Candidates) -> IndirectLight:
    """Fit S with functions of finer and finer scales, where the pictures need them."""
    camera, projector = problem.camera, problem.projector
    start = _start(problem, footprints)
    data, mean = start.data, float(floodlit_by_all(problem.grey).mean(dtype=np.float64))

    def fit(functions: NDArray[np.int32], previous: IndirectLight | None) -> IndirectLight | None:
        basis = IndirectBasis(start.chart.basis(functions), projector, start.mapping)
        if previous is not None and basis.part_count > problem.largest_part_count:
            return None
        gains = (np.ones(camera.size, np.float32), np.ones(projector.size, np.float32))
        if previous is not None:
            gains = previous.camera_gain, previous.projector_gain
        parts = np.zeros(basis.part_count, np.float32)
        light = IndirectLight(basis, start.f, start.g, *gains, parts)
        light = fit_cores(light, data, basis.prior_deviations(start.indirect, mean), ROUGH)
        return fit_gains(fit_cores(light, data, light.learned_deviations(), GOOD), data)

    def cells_to_refine(light: IndirectLight, scale: int) -> Bools:
        # the two coarsest scales cover the whole chart; only finer ones depend on the residual
        if 2 * scale == coarsest_scale(start.chart.shape):
            return np.ones(cells(start.chart.shape, scale), np.bool_)
        return _unexplained_chart_cells(start.chart, scale, light, data)

    light = coarse_to_fine(start.chart.shape, fit, cells_to_refine)
    return fit_cores(light, data, light.learned_deviations(), BEST)


class _Start(NamedTuple):
    """Inputs of a fit of indirect light, computed from footprints.

    Attributes
    ----------
    chart : Chart
    mapping : CameraToProjector
    f, g : ndarray of float32, shape (M,) and (N,)
    indirect : float
        Mean indirect light of the floodlit image, radiance.
    data : FitData
    """

    chart: Chart
    mapping: CameraToProjector
    f: Float
    g: Float
    indirect: float
    data: FitData


def _start(problem: _Problem, footprints: Candidates) -> _Start:
    """Compute the inputs of a fit of indirect light."""
    camera, grey = problem.camera, problem.grey
    direct, floodlit = footprints.matrix(), floodlit_by_all(grey)
    # a single coaxial pair is left to near/far acquisition; here it counts as any rig of one view
    is_coaxial = len(grey) > 1 and camera == problem.projector and is_symmetric(footprints)
    mapping = identity_map(camera.size) if is_coaxial else camera_to_projector(direct, floodlit)
    f = camera_factor(direct, floodlit)
    return _Start(
        _chart(problem, footprints),
        mapping,
        f,
        projector_factor(mapping, f, floodlit),
        _mean_indirect_light(grey, floodlit, direct),
        fit_data(grey, footprints, problem.camera_rays),
    )


def _chart(problem: _Problem, footprints: Candidates) -> Chart:
    """Return the image of the middle projector view, or the camera's if there is one view."""
    views = len(problem.grey)
    if views == 1:
        return Chart(problem.camera.shape)
    middle = views // 2
    direct = on_view(footprints, middle, views).matrix()
    shape, floodlit = problem.projector.image_shape, problem.grey[middle].floodlit
    return chart_from_view(problem.camera, direct, shape, floodlit)


def _mean_indirect_light(
    pictures: PicturesByView, floodlit: Float, direct: csr_array[np.float32]
) -> float:
    """Estimate the mean indirect light of the floodlit image, radiance, at least 0.

    With one view it is measured where footprints are dark, in patterns with half of the pixels lit.
    """
    direct_light: Float = np.asarray(direct.sum(axis=1)).ravel()
    if len(pictures) > 1:
        return max(float((floodlit - direct_light).mean(dtype=np.float64)), 0.0)
    (view,) = pictures
    positive = np.maximum(direct_light, np.finfo(np.float32).tiny)
    light, weight = 0.0, 0.0
    for first, last in view.ranges():
        part = view.at(slice(first, last))
        lit_part = (direct[first:last] @ view.patterns[:, 1:]) / positive[first:last, None]
        # 1 where no direct light is on, 0 where at least a quarter of it is on
        dark = (1 - np.clip(4 * lit_part, 0, 1)) * part.known[:, None]
        light += float((np.where(dark > 0, part.radiance[:, 1:], 0) * dark).sum(dtype=np.float64))
        weight += float(dark.sum(dtype=np.float64))
    return max(2 * light, 0.0) / max(weight, 1.0)


def _unexplained_chart_cells(
    chart: Chart, scale: int, light: IndirectLight, data: FitData
) -> Bools:
    """Find the chart cells whose errors exceed noise and 0.4 % of the floodlit image."""
    cell = chart.chart_cells(scale)
    if data.camera_rays is not None:
        cell = cell[data.camera_rays]
    chi_square, freedom, allowed = misfit(light, data, _ALLOWED_ERROR)
    shape = cells(chart.shape, scale)
    return beyond_noise(shape, cell, chi_square, freedom, freedom, allowed)
