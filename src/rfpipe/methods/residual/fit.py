"""Fit of the residual to the pictures of all rounds.

`rfpipe.methods.residual.model` has the model's equation and symbols. The residual of the pictures,
fitted to cells, determines K (`rfpipe.methods.residual.posterior`). The light between two cells,
K plus the light of T0 there, can't be negative. This constraint contributes as much to K as many
pictures would. It is imposed by alternation: clip K, then add a fit to the residual of the clipped
K. The last fit isn't clipped, so that the constraint holds nearly, not exactly.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.methods.images import relight_white
from rfpipe.methods.residual.model import CameraCells, CellPictures, ProjectorCells, Residual
from rfpipe.methods.residual.posterior import (
    CellData,
    Posterior,
    cell_data,
    initial_prior,
    learned_prior,
)
from rfpipe.steps import step, steps
from rfpipe.transport.base import Transport

# Number of times that the prior is learned and that K is clipped; iterations of each solution.
_LEARNINGS, _CLIPPINGS, _ITERATIONS = 2, 8, 8
# Largest number of pictures in the fit: the time grows with its square, and so does the memory, to
# 1.3 GB for 4096 cells.
_MOST_PICTURES = 512
# Pictures that are relit at a time.
_BATCH = 64
# Error of each picture that is assumed in any case, relative to the brightest floodlit pixel.
_MODEL_ERROR = 5e-4
# Change of the norm of a picture that removing small cores may cause.
_REMOVED = 5e-4
_TINY = float(np.finfo(np.float32).tiny)


def fit_residual(
    camera: CameraCells, projector: ProjectorCells, pictures: CellPictures, model: Transport
) -> Residual:
    """Compute the most probable residual of a model.

    Parameters
    ----------
    camera : CameraCells
    projector : ProjectorCells
        On coaxial rigs `coaxial_projector`.
    pictures : CellPictures
        Of all rounds, the floodlit picture first.
    model : Transport
        T0; it need not be accurate.
    """
    chosen, residual, variance = _fitted_pictures(camera, pictures, model)
    lit, observed = pictures.lit[chosen], pictures.radiance[chosen]
    channels, sizes = len(camera.factor), (camera.cells.haar.size, projector.cells.haar.size)
    cores = np.zeros((channels, *sizes), np.float32)
    power = np.zeros((channels, sizes[1]))
    prior: Float | None = None
    brightest = int(np.argmax(camera.brightest))
    # the prior is learned from the brightest channel, whose noise is least, and serves all
    order = sorted(range(channels), key=lambda channel: channel != brightest)
    shining = [channel for channel in order if camera.brightest[channel] > 0]
    with steps("light between cells", _LEARNINGS + len(shining) * (1 + _CLIPPINGS)):
        for channel in shining:
            data = cell_data(
                camera.cells.haar,
                projector.cells.total(lit * projector.factor[channel]),
                residual[:, channel].T,
                variance[:, channel].T,
                None if projector.places is None else (projector.cells.haar, projector.places),
            )
            prior = _learn_prior(data) if prior is None else prior
            share = camera.brightest[channel] / camera.brightest[brightest]
            model_light = _light_between_cells(camera, projector, model, channel)
            matrix = _fit_nearly_non_negative(data, prior * share**2, model_light)
            half = camera.cells.haar.forward(matrix)
            cores[channel] = projector.cells.haar.forward(np.ascontiguousarray(half.T)).T
            energy = np.square(observed[:, channel], dtype=np.float64).sum(axis=1).mean()
            power[channel] = np.square(data.light, dtype=np.float64).mean(axis=1) / energy
    return _without_small_cores(cores, power, projector)


def _fitted_pictures(
    camera: CameraCells, pictures: CellPictures, model: Transport
) -> tuple[NDArray[np.int64], Float, Float]:
    """Choose at most 512 pictures: the first and those that the model predicts worst.

    Returns
    -------
    chosen : ndarray of int64, shape (chosen,)
        Indices of the pictures.
    residual, variance : ndarray of float32, shape (chosen, C, M')
        The variance includes the assumed error of a picture.
    """
    batches = np.split(pictures.lit, range(_BATCH, len(pictures.lit), _BATCH))
    predicted = [camera.fitted_to_cells(relight_white(model, lit)) for lit in batches]
    residual = pictures.radiance - np.concatenate(predicted)
    model_variance = np.square(np.float32(_MODEL_ERROR) * camera.brightest)
    variance = pictures.variance + model_variance[:, None]
    if len(residual) <= _MOST_PICTURES:
        return np.arange(len(residual)), residual, variance
    known = np.isfinite(variance) & (variance > 0)
    excess = np.divide(np.square(residual), variance, where=known, out=np.zeros_like(residual))
    worst = np.argsort(-excess[1:].sum(axis=(1, 2), dtype=np.float64), kind="stable")
    chosen = np.concatenate([[0], np.sort(worst[: _MOST_PICTURES - 1]) + 1])
    return chosen, residual[chosen], variance[chosen]


def _learn_prior(data: CellData) -> Float:
    """Learn the prior variances of the exchange between cells from the pictures."""
    prior = initial_prior(data)
    for _ in range(_LEARNINGS):
        posterior = Posterior.of(data, prior)
        prior = learned_prior(posterior, posterior.solve(data.observed, _ITERATIONS).core)
        step()
    return prior


def _fit_nearly_non_negative(data: CellData, prior: Float, model_light: Float) -> Float:
    """Compute K, (M', N'), such that light between cells is nearly non-negative.

    Each of 8 clippings raises K to at least minus the model's light between cells, and is followed
    by a fit to the residual of the clipped K. Since each of these fits would follow more of the
    noise, they count its variance 8 times. The last of them isn't clipped: K may be below the bound
    by its correction. The light of a cell to itself is not bounded on coaxial rigs.

    Parameters
    ----------
    data : CellData
    prior : ndarray of float32, shape (m, n)
        V.
    model_light : ndarray of float32, shape (M', N')
        Light of T0 between cells, over f and g.
    """
    posterior = Posterior.of(data, prior)
    core, direct = posterior.solve(data.observed, 2 * _ITERATIONS)
    matrix = data.matrix(core)
    step()
    posterior = Posterior.of(data, prior, _CLIPPINGS)
    is_between = np.ones(matrix.shape, np.bool_)
    if data.is_symmetric:
        np.fill_diagonal(is_between, val=False)
    for _ in range(_CLIPPINGS):
        np.maximum(matrix, -model_light, out=matrix, where=is_between)
        core, more_direct = posterior.solve(data.residual(matrix, direct), _ITERATIONS)
        matrix += data.matrix(core)
        direct = direct + more_direct
        step()
    return matrix


def _light_between_cells(
    camera: CameraCells, projector: ProjectorCells, model: Transport, channel: int
) -> Float:
    """Compute the light of T0 between cells, over f and g, (M', N')."""
    factor, weight = camera.factor[channel], camera.weight[channel]
    projector_factor = projector.factor[channel]
    light = projector.cells.total(np.square(projector_factor)[None])[:, 0]
    received = camera.cells.shared_out(factor * camera.known, weight)
    sent = projector.cells.shared_out(projector_factor, light)
    matrix = model.between(received, sent, channel)
    return np.float32(0.5) * (matrix + matrix.T) if projector.is_coaxial else matrix


def _without_small_cores(
    cores: Float, power: NDArray[np.float64], projector: ProjectorCells
) -> Residual:
    """Drop the smallest cores, which together change a picture by at most 0.05 % of its norm.

    Parameters
    ----------
    cores : ndarray of float32, shape (C, m, n)
        X of all pairs of wavelets.
    power : ndarray of float64, shape (C, n)
        Mean square of the light that patterns send in a wavelet, over the mean energy of pictures.
    projector : ProjectorCells
    """
    change = np.zeros(cores.shape[1:], np.float32)
    for entries, weight in zip(cores, power.astype(np.float32), strict=True):
        weights = weight + weight[:, None] if projector.is_coaxial else weight
        np.maximum(change, np.square(entries) * weights, out=change)
    if projector.is_coaxial:
        change[np.diag_indices(len(change))] /= 2
        change = np.triu(change)
    rising = np.sort(change, axis=None)
    dropped = np.searchsorted(np.cumsum(rising, dtype=np.float64), _REMOVED**2, side="right")
    least = np.append(rising, np.inf)[dropped]
    pairs = np.stack(np.nonzero(change >= max(least, _TINY))).astype(np.int32)
    channels = len(cores)
    factor = np.zeros((channels, 0), np.float32) if projector.is_coaxial else projector.factor
    return Residual(pairs, np.ascontiguousarray(cores[:, pairs[0], pairs[1]]), factor)
