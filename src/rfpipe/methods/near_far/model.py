"""Near/far acquisition: indirect light from few pictures, by regularised least squares.

The model is ``T = diag(d) + F B S B^T F``: direct light d, and indirect light that is smooth up to
the floodlit image F on both sides. What the floodlit image shows fixes d, so that a picture c of
pattern p tells of S alone: ``c - F p = F (B S B^T F p - p B S B^T F 1)``. On dark pixels that is
the indirect light itself, measured without the noise of the direct.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Float
from rfpipe.methods.near_far.pictures import SIGNIFICANT, Pictures
from rfpipe.methods.near_far.solve import Evidence, Observations, Patches, Prior, residual, solve
from rfpipe.transport.multiscale.basis import (
    MultiscaleBasis,
    cells,
    coarsest_scale,
    functions_over,
)

__all__ = ["Model", "fit"]

# Fractions of the floodlit image: what a model may be wrong by on a dark pixel before finer
# functions are added there, and what it is taken to be wrong by in any case. A basis that is finer
# than the pictures can tell makes errors larger; on scenes with one, two and three creases the best
# values lay between half and twice these, flatly.
_REFINED_AT = 0.005
_WEIGHED_AT = 0.002
# Steps on the way to the basis, and to the cores, need no more than this; one channel's cores
# differ little from those of all.
_ROUGHLY, _NEARLY, _FULLY, _APART = (3e-3, 60), (1e-3, 120), (1.5e-4, 300), (3e-4, 300)
# A basis does not grow beyond so many pairs, which take a gigabyte while they are found.
_MOST_PAIRS = 2**24


@dataclass(frozen=True)
class Model:
    """Indirect light as found.

    Attributes
    ----------
    basis : MultiscaleBasis
    cores : ndarray of float32, shape (C, pairs)
    """

    basis: MultiscaleBasis
    cores: Float


def fit(shape: tuple[int, ...], pictures: Pictures) -> Model:
    """Find which functions the scene needs, and the light that they exchange.

    All channels together tell most; what one of them alone tells is found from there.

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    pictures : Pictures
    """
    grey = pictures.grey()
    evidence = Evidence.of(grey, _WEIGHED_AT)
    patches = Patches(_refined_basis(shape, grey, evidence))
    basis = patches.basis
    cores = np.zeros((pictures.channels, len(basis.first)), np.float32)
    if not grey.shine():
        return Model(basis, cores)
    seen = Observations.of(patches, evidence)
    prior = Prior.of(basis, seen)
    # from nothing: cores that fewer pictures told keep the prior that is learned from drawing near
    near = solve(seen, prior.deviations, *_NEARLY)
    learned = prior.learned(near)
    found = solve(seen, learned, *_FULLY, near)
    for index in range(pictures.channels):
        channel = pictures.channel(index)
        if pictures.channels == 1:
            cores[index] = found
        elif channel.shine():
            own = Evidence.of(channel, _WEIGHED_AT)
            scale = np.float32(own.core / evidence.core if evidence.core else 0)
            told = Observations.of(patches, own)
            cores[index] = solve(told, scale * learned, *_APART, scale * found)
    return Model(basis, cores)


def _refined_basis(
    shape: tuple[int, ...], pictures: Pictures, evidence: Evidence
) -> MultiscaleBasis:
    """Add functions, scale by scale, where pictures differ from the model beyond noise."""
    scale = coarsest_scale(shape)
    functions = [functions_over(scale, np.ones(cells(shape, scale), np.bool_))]
    basis = MultiscaleBasis(shape, functions[0])
    while scale > 1 and pictures.shine():
        seen = Observations.of(Patches(basis), evidence)
        cores = solve(seen, Prior.of(basis, seen).deviations, *_ROUGHLY)
        scale //= 2
        wanted = _wanting(shape, scale, pictures, residual(basis, pictures, cores))
        functions.append(functions_over(scale, wanted))
        finer = MultiscaleBasis(shape, np.concatenate(functions))
        if len(finer.first) > _MOST_PAIRS:
            break
        basis = finer
    return basis


def _wanting(
    shape: tuple[int, ...], scale: int, pictures: Pictures, wrong: Float
) -> NDArray[np.bool_]:
    """Find the cells of a scale whose dark pixels the model gets wrong, beyond noise.

    Parameters
    ----------
    wrong : ndarray of float32, shape (M, N)
        Radiance less what the model predicts.
    """
    dark = pictures.known & ~pictures.lit
    views, down, across = cells(shape, scale)
    height, width = RayDomain(shape).image_shape
    row, column = np.arange(height) // scale, np.arange(width) // scale
    cell = (row[:, None] * across + column).ravel()
    cell = (np.arange(views)[:, None] * (down * across) + cell).ravel()

    def total(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(cell, values, views * down * across).astype(np.float64)

    variance = np.where(dark, pictures.variance[:, 0], 0)
    noise = total(variance.sum(axis=0, dtype=np.float64))
    excess = total(np.where(dark, wrong * wrong, 0).sum(axis=0, dtype=np.float64)) - noise
    chance = total(np.square(variance, dtype=np.float64).sum(axis=0))
    significant = excess > SIGNIFICANT * np.sqrt(2 * chance)
    floodlit = pictures.floodlit[0].astype(np.float64)
    allowed = total((_REFINED_AT * floodlit) ** 2 * dark.sum(axis=0))
    wanted: NDArray[np.bool_] = significant & (excess > allowed)
    return wanted.reshape(views, down, across)
