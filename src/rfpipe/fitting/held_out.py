"""Pictures that are left out of a fit to estimate its error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.fitting.series import Series
from rfpipe.provenance import generator
from rfpipe.relighting import relative_errors

# Correlation beyond which patterns are alike, or complements of each other.
_ALIKE = 0.98
# Groups of pictures from which on an eighth is left out, of fewer half; pictures at most.
_MANY, _PART, _MOST = 8, 8, 16
# The finest patterns of a code are left out: coarser ones and neighbours predict them, while
# nothing predicts a coarse one. Detail is narrower than a width in pixels; patterns whose share of
# detail is at least a part of the largest share may be left out, if their contrast is at least a
# part of the largest contrast: binning makes the very finest ones even.
_DETAIL, _FINE, _CONTRAST = 2.0, 0.9, 0.5
_CHOICES = 8


def dependent_groups(patterns: Float) -> Index:
    """Label pictures that predict each other: repeated patterns, and complements.

    Parameters
    ----------
    patterns : ndarray of float32, shape (K, C, N)

    Returns
    -------
    ndarray of int64, shape (K,)
        Equal numbers for pictures of one group; -1 for even light, which many groups predict.
    """
    from scipy.sparse.csgraph import connected_components

    rows = patterns.reshape(len(patterns), -1)
    centred = rows - rows.mean(axis=1, keepdims=True)
    contrast = np.linalg.norm(centred, axis=1)
    shaped = contrast > 0.02 * np.linalg.norm(rows, axis=1)
    unit = centred / np.where(shaped, contrast, 1)[:, None]
    related = np.abs(unit @ unit.T) > _ALIKE
    if rows.shape[1] <= 2:  # two rays' patterns are complements whatever they are
        related &= unit @ unit.T > _ALIKE
    labels = connected_components(related, directed=False)[1]
    return np.where(shaped, labels, -1).astype(np.int64)


def held_out_pictures(series: Series) -> Index:
    """Choose whole groups of dependent pictures to leave out, ascending.

    They are an eighth of the groups, at most 16 pictures, or half of fewer than 8 groups. Of
    complete patterns they are groups without which the others stay complete, where a few random
    choices find such; of other patterns, groups with the finest patterns.
    """
    labels = dependent_groups(series.patterns)
    names = np.unique(labels[labels >= 0])
    if len(names) < 2:
        return np.zeros(0, np.int64)
    count = -(-len(names) // _PART) if len(names) >= _MANY else len(names) // 2
    if not series.is_complete:
        detail, contrast = (
            np.array([values[labels == name].max() for name in names])
            for values in _structure(series)
        )
        share = np.where(contrast >= _CONTRAST * contrast.max(), detail / contrast, 0)
        return _members(labels, names[share >= _FINE * share.max()], count, 0)
    for seed in range(_CHOICES):
        chosen = _members(labels, names, count, seed)
        remaining = np.setdiff1d(np.arange(len(labels)), chosen)
        if series.some(remaining).is_complete:
            break
    return chosen


def _members(labels: Index, names: Index, count: int, seed: int) -> Index:
    """Return the pictures of some random groups, at most `_MOST` of several groups, ascending."""
    chosen = np.zeros(0, np.int64)
    for name in generator(seed, len(names)).permutation(names)[:count]:
        members = np.flatnonzero(labels == name)
        if len(chosen) and len(chosen) + len(members) > _MOST:
            break
        chosen = np.concatenate([chosen, members])
    return np.sort(chosen)


def dependents(series: Series, held_out: Index) -> Index:
    """Return all pictures in the groups of some, these included, ascending."""
    labels = dependent_groups(series.patterns)
    groups = np.setdiff1d(labels[held_out], [-1])
    return np.union1d(np.flatnonzero(np.isin(labels, groups)), held_out)


def mean_error(predicted: Float, held_out: Series) -> float:
    """Return the mean error of predicted pictures relative to their norms, less their noise.

    Parameters
    ----------
    predicted : ndarray of float32, shape (K, C, M)
    held_out : Series
        The pictures; black ones and unknown rays don't count.
    """
    known = held_out.known
    residual = (predicted - held_out.radiance)[..., known]
    wrong = np.square(residual, dtype=np.float64).sum(axis=(1, 2))
    wrong -= held_out.variance[..., known].sum(axis=(1, 2), dtype=np.float64)
    light = np.square(held_out.radiance[..., known], dtype=np.float64).sum(axis=(1, 2))
    errors = relative_errors(wrong, light)[light > 0]
    return float(errors.mean()) if errors.size else 0.0


def mean_picture(training: Series, patterns: Float) -> Float:
    """Predict pictures of patterns (K, C, N) as the mean picture times the patterns' light."""
    light = training.patterns.mean(axis=(0, 2), dtype=np.float64)
    mean = training.radiance.mean(axis=0, dtype=np.float64) / light[:, None]
    predicted: Float = patterns.mean(axis=2)[..., None] * mean.astype(np.float32)
    return predicted


def _structure(series: Series) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the contrast of each pattern's detail, and of all its structure, (K,) each."""
    from scipy.ndimage import gaussian_filter

    stack = RayDomain(series.projector_shape).stack_shape
    detail, contrast = np.empty((2, len(series.patterns)))
    for index, pattern in enumerate(series.patterns):
        image = pattern.reshape(-1, *stack)
        smooth = gaussian_filter(image, (0, 0, _DETAIL, _DETAIL))
        detail[index], contrast[index] = float(np.std(image - smooth)), float(np.std(image))
    return detail, contrast
