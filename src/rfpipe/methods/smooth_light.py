"""Parts of the fit of smooth indirect light that near/far and footprint acquisition share.

Both models describe indirect light by *cores*: the entries of a matrix S, one for each pair of
B-splines of several scales (`rfpipe.transport.multiscale.MultiscaleBasis`). Cores are independent
normal variables with mean zero. Before any fit, their standard deviations fall with the squared
distance of the splines; afterwards they are learned from the fitted cores, group by group. Splines
of a finer scale are added only where the pictures need them.

In footprint acquisition S is not symmetric. There each pair has two *core parts* instead, the
symmetric and the antisymmetric part of its entries (`rfpipe.methods.footprints.functions`), and
these functions treat core parts as cores.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from rfpipe.array_types import Bools, Double, Float, FunctionTable, Index
from rfpipe.transport.multiscale import (
    MultiscaleBasis,
    cells,
    coarsest_scale,
    functions_over,
)

# Octaves of distance among which indirect light is shared before any fit. The number is large, so
# that cores begin small; deviations that are learned from the pictures replace it.
_OCTAVES = 12.0

Model = TypeVar("Model")


def prior_areas(basis: MultiscaleBasis) -> Double:
    """Compute the area over which each pair's indirect light is assumed to be spread, (pairs,).

    It is 12 times the squared distance of the two functions, or 12 times the squared scale of the
    coarser one where they are closer, in squared pixels. Before any fit, the deviation of a core is
    inversely proportional to it.
    """
    coarser = np.maximum(basis.scales[basis.first], basis.scales[basis.second])
    area: Double = np.square(np.maximum(basis.distances(), coarser)) * _OCTAVES
    return area


def learned_deviations(group: Index, cores: Float) -> Float:
    """Estimate the cores' standard deviations: the root mean square of each group, (cores,).

    `group` has the number of each core's group.
    """
    energy = np.bincount(group, np.square(cores, dtype=np.float64))
    deviations = np.sqrt(energy / np.bincount(group))[group]
    return deviations.astype(np.float32)


def coarse_to_fine(
    shape: tuple[int, ...],
    fit: Callable[[FunctionTable, Model | None], Model | None],
    cells_to_refine: Callable[[Model, int], Bools],
) -> Model:
    """Fit a model with functions of finer and finer scales, where the pictures need them.

    Parameters
    ----------
    shape : tuple of int
        Ray domain of the functions.
    fit : callable
        ``fit(functions, previous)`` returns the model with a table of functions; `previous` is the
        model of the coarser functions, None at first. It returns None if there are too many pairs
        of functions to fit.
    cells_to_refine : callable
        ``cells_to_refine(model, scale)`` returns the cells of a scale in which the model differs
        from the pictures, bool ``cells(shape, scale)``.

    Returns
    -------
    model
        With all scales down to single rays, or to the last one before `fit` returns None.
    """
    scale = coarsest_scale(shape)
    functions = functions_over(scale, np.ones(cells(shape, scale), np.bool_))
    model = fit(functions, None)
    assert model is not None, "the coarsest functions are too many"
    while scale > 1:
        scale //= 2
        finer = functions_over(scale, cells_to_refine(model, scale))
        functions = np.concatenate([functions, finer])
        refined = fit(functions, model)
        if refined is None:
            return model
        model = refined
    return model
