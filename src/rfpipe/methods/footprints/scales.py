"""Fit of indirect light with functions of finer and finer scales, given footprints.

The fit begins with the coarsest functions. Finer ones are added where the pictures differ from the
model by more than noise and 0.4 % of the floodlit image. Chart, factors f and g, and the precisions
of pictures are computed from the footprints at first, and stay the same at all scales.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Bools, Float
from rfpipe.methods.footprints.candidates import StoredCandidates
from rfpipe.methods.footprints.charts import Chart, chart_from_view
from rfpipe.methods.footprints.functions import (
    CameraToProjector,
    IndirectBasis,
    camera_factor,
    camera_to_projector,
    identity_map,
    projector_factor,
)
from rfpipe.methods.footprints.indirect import (
    ROUGH,
    Accuracy,
    FitData,
    IndirectLight,
    fit_cores,
    fit_data,
    fit_gains,
    misfit,
)
from rfpipe.methods.footprints.pictures import floodlit_by_all
from rfpipe.methods.footprints.problem import PicturesByView, Problem
from rfpipe.methods.footprints.reciprocity import is_symmetric
from rfpipe.methods.images import beyond_noise
from rfpipe.methods.smooth_light import coarse_to_fine
from rfpipe.transport.multiscale import cells, coarsest_scale

# Finer functions are added where the error exceeds this fraction of the floodlit image.
_ALLOWED_ERROR = 0.004


class ScaleAccuracies(NamedTuple):
    """Accuracies of S in a fit of indirect light: at each scale, and with all functions."""

    scale: Accuracy
    final: Accuracy


def fit_indirect_light(
    problem: Problem, footprints: StoredCandidates, accuracies: ScaleAccuracies
) -> IndirectLight:
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
        return fit_gains(fit_cores(light, data, light.learned_deviations(), accuracies.scale), data)

    def cells_to_refine(light: IndirectLight, scale: int) -> Bools:
        # the two coarsest scales cover the whole chart; only finer ones depend on the residual
        if 2 * scale == coarsest_scale(start.chart.shape):
            return np.ones(cells(start.chart.shape, scale), np.bool_)
        return _unexplained_chart_cells(start.chart, scale, light, data)

    light = coarse_to_fine(start.chart.shape, fit, cells_to_refine)
    return fit_cores(light, data, light.learned_deviations(), accuracies.final)


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


def _start(problem: Problem, footprints: StoredCandidates) -> _Start:
    """Compute the inputs of a fit of indirect light."""
    camera, grey = problem.camera, problem.grey
    floodlit = floodlit_by_all(grey)
    direct_light = np.zeros_like(floodlit)
    for part in footprints:
        direct_light += np.asarray(part.matrix().sum(axis=1)).ravel()
    # a single coaxial pair is left to near/far acquisition; here it counts as any rig of one view
    is_coaxial = len(grey) > 1 and camera == problem.projector and is_symmetric(footprints)
    if is_coaxial:
        mapping = identity_map(camera.size)
    else:
        mapping = camera_to_projector((part.matrix() for part in footprints), floodlit)
    f = camera_factor(direct_light, floodlit)
    return _Start(
        _chart(problem, footprints),
        mapping,
        f,
        projector_factor(mapping, f, floodlit),
        _mean_indirect_light(grey, footprints, floodlit - direct_light),
        fit_data(grey, footprints, problem.camera_rays),
    )


def _chart(problem: Problem, footprints: StoredCandidates) -> Chart:
    """Return the image of the middle projector view, or the camera's if there is one view."""
    views = len(problem.grey)
    if views == 1:
        return Chart(problem.camera.shape)
    middle = views // 2
    direct = footprints[middle].matrix()
    shape, floodlit = problem.projector.image_shape, problem.grey[middle].floodlit
    return chart_from_view(problem.camera, direct, shape, floodlit)


def _mean_indirect_light(
    pictures: PicturesByView, footprints: StoredCandidates, indirect: Float
) -> float:
    """Estimate the mean indirect light of the floodlit image, radiance, at least 0.

    With one view it is measured where footprints are dark, in patterns with half of the pixels lit.
    With several, it is the mean of `indirect`, the floodlit image minus direct light, (M,).
    """
    if len(pictures) > 1:
        return max(float(indirect.mean(dtype=np.float64)), 0.0)
    (view,), direct = pictures, footprints[0].matrix()
    positive = np.maximum(np.asarray(direct.sum(axis=1)).ravel(), TINY)
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
