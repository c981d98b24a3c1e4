"""Fit of the residual to the pictures of all rounds.

`rfpipe.methods.residual.model` has the model's equation and symbols. The residual of the pictures,
fitted to cells, determines K (`rfpipe.methods.residual.posterior`). The light between two cells,
K plus the light of T0 there, can't be negative. This constraint contributes as much to K as many
pictures would. It is imposed by steps that clip K and add a fit to the residual of the clipped K,
as in projected gradient methods with Nesterov's momentum [1]_. The last fit isn't clipped, so that
the constraint holds nearly, not exactly.

The steps begin at the residual of the round before, or at the brightest channel's K. Twice as many
from K = 0 leave the same error, within 1 % on the benchmark's tuning scenes.

References
----------
.. [1] A. Beck and M. Teboulle, *A fast iterative shrinkage-thresholding algorithm for linear
   inverse problems*, SIAM J. Imaging Sci. 2 (2009).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Float
from rfpipe.methods.images import batches, relight_white
from rfpipe.methods.residual.cell_data import CellData, cell_data
from rfpipe.methods.residual.model import CameraCells, CellPictures, ProjectorCells, Residual
from rfpipe.methods.residual.posterior import PairExchange, Posterior
from rfpipe.methods.residual.prior import learn_prior, threshold_below
from rfpipe.steps import step, steps
from rfpipe.transport.base import Transport

# Number of steps of a fit from K = 0 and from an estimate of K; iterations of each step's solution,
# and the factor of the variances in it.
_STEPS, _STEPS_FROM_ESTIMATE, _ITERATIONS, _NOISE_SCALE = 6, 3, 8, 8
# Largest number of pictures in the fit: the time grows with its square, and so does the memory, to
# 0.7 GB for 4096 cells.
_MOST_PICTURES = 512
# Error of each picture that is assumed in any case, relative to the brightest floodlit pixel.
_MODEL_ERROR = 5e-4
# Change of the norm of a picture that removing small cores may cause.
_REMOVED = 5e-4


def fit_residual(
    camera: CameraCells,
    projector: ProjectorCells,
    pictures: CellPictures,
    model: Transport,
    previous: Residual | None = None,
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
    previous : Residual, optional
        Residual of the same model for fewer pictures; the fit starts from it.
    """
    chosen, residual, variance = _fitted_pictures(camera, pictures, model)
    lit, observed = pictures.lit[chosen], pictures.radiance[chosen]
    haar, sender_haar = camera.cells.haar, projector.cells.haar
    cores = np.zeros((len(camera.factor), haar.size, sender_haar.size), np.float32)
    power = np.zeros((len(camera.factor), sender_haar.size))
    # the prior is learned from the brightest channel, whose noise is least, and serves all
    shining = np.argsort(-camera.brightest, kind="stable")[: np.count_nonzero(camera.brightest > 0)]
    prior = brightest_matrix = None
    with steps("light between cells", _solution_count(len(shining), previous is not None)):
        for channel in shining:
            data = cell_data(
                haar,
                projector.cells.total(lit * projector.factor[channel]),
                residual[:, channel].T,
                variance[:, channel].T,
                None if projector.places is None else (sender_haar, projector.places),
            )
            prior = learn_prior(data) if prior is None else prior
            share = np.float32(camera.brightest[channel] / camera.brightest[shining[0]])
            start = None if brightest_matrix is None else share * brightest_matrix
            if previous is not None:
                first, second = previous.pairs
                start = data.matrix(first, second, previous.cores[channel])
            model_light = _light_between_cells(camera, projector, model, channel)
            matrix = _fit_nearly_non_negative(data, prior * share**2, model_light, start)
            brightest_matrix = matrix if brightest_matrix is None else brightest_matrix
            cores[channel] = haar.forward_both(matrix, sender_haar)
            energy = np.square(observed[:, channel], dtype=np.float64).sum(axis=1).mean()
            power[channel] = np.square(data.light, dtype=np.float64).mean(axis=1) / energy
    return _without_small_cores(cores, power, projector)


def _solution_count(channels: int, has_previous: bool) -> int:
    """Count the solutions of a fit, for displays of progress."""
    first = _STEPS_FROM_ESTIMATE if has_previous else _STEPS
    return 1 + first + (channels - 1) * _STEPS_FROM_ESTIMATE


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
    predicted = [
        camera.fitted_to_cells(relight_white(model, pictures.lit[first:last]))
        for first, last in batches(len(pictures.lit), camera.factor.size)
    ]
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


def _fit_nearly_non_negative(
    data: CellData, prior: Float, model_light: Float, start: Float | None
) -> Float:
    """Compute K, (M', N'), such that light between cells is nearly non-negative.

    Each step extrapolates the change of the last step (Nesterov's momentum), raises K to at least
    minus the model's light between cells, and adds a fit to the residual of this K. Since each of
    these fits would follow more of the noise, they count its variance 8 times. The last of them
    isn't clipped: K may be below the bound by its correction. The light of a cell to itself is not
    bounded on coaxial rigs.

    Parameters
    ----------
    data : CellData
    prior : ndarray of float32, shape (m, n)
        V.
    model_light : ndarray of float32, shape (M', N')
        Light of T0 between cells, over f and g.
    start : ndarray of float32, shape (M', N'), optional
        First estimate of K; 0 by default.
    """
    from rfpipe.methods.residual.pair_kernels import extrapolate

    exchange = PairExchange.of(data, prior)
    posterior = Posterior.of(data, prior, exchange, _NOISE_SCALE)
    matrix = np.zeros_like(model_light) if start is None else start
    direct = data.direct(matrix)
    previous, previous_direct, momentum = matrix.copy(), direct, 1.0
    for _ in range(_STEPS if start is None else _STEPS_FROM_ESTIMATE):
        following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        weight, momentum = (momentum - 1) / following, following
        extrapolate(matrix, previous, weight, -model_light, data.is_symmetric)
        direct, previous_direct = direct + np.float32(weight) * (direct - previous_direct), direct
        core, more_direct = posterior.solve(data.residual(matrix, direct), _ITERATIONS)
        matrix += data.matrix(exchange.pairs.first, exchange.pairs.second, core)
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
    least = threshold_below(change, _REMOVED**2)
    pairs = np.stack(np.nonzero(change >= max(least, TINY))).astype(np.int32)
    channels = len(cores)
    factor = np.zeros((channels, 0), np.float32) if projector.is_coaxial else projector.factor
    return Residual(pairs, np.ascontiguousarray(cores[:, pairs[0], pairs[1]]), factor)
