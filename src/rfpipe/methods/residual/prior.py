"""Prior variances V of the exchange between wavelets, learned from residual pictures.

V first falls with the squared distance of two places and is then learned from the most probable
exchange and its uncertainty (empirical Bayes). Most pairs of wavelets hardly exchange light; their
prior variance is set to 0. `rfpipe.methods.residual.posterior` has the table of symbols.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import TINY, Float
from rfpipe.methods.residual.cell_data import CellData
from rfpipe.methods.residual.posterior import DenseExchange, Posterior
from rfpipe.transport.wavelet import Group

# Distance, in cells, at which the prior variance has fallen to half.
_HALF_DISTANCE = 0.5
# Iterations of the solution for the initial prior.
_ITERATIONS = 8
# Least share of the prior variance that remains after a fit, which keeps V above 0.
_LEAST_UNCERTAINTY = 1e-4
# Share of the expected light of all pairs of wavelets that pairs without a prior variance may have.
# At 48 x 48 a tenth of the pairs remains, with the same errors; at 3 % errors grow by 8 %.
_INSIGNIFICANT = 0.01
# Last bits of a float32 that a class of `threshold_below` disregards.
_CLASS_BITS = 16


def initial_prior(data: CellData) -> Float:
    """Compute V before any fit: it falls with the squared distance of two places.

    Its sum is such that the prior explains the energy of the residual pictures.
    """
    changing = data.light - data.light.mean(axis=1, keepdims=True)
    power = np.square(changing, dtype=np.float64).sum(axis=0).mean() / len(changing)
    energy = np.square(data.observed, dtype=np.float64).sum(axis=0).mean()
    prior = np.empty((data.haar.size, data.sender_haar.size), np.float32)
    for group, sender_group in data.scale_pairs():
        falloff = 1 + np.square(data.distances(group, sender_group) / _HALF_DISTANCE)
        pairs = (group.side * sender_group.side) ** 2 / falloff
        _write_pairs(prior, data, (group, sender_group), pairs.astype(np.float32))
    total = float(energy / max(power, TINY))
    prior *= np.float32(total / prior.sum(dtype=np.float64))
    return prior


def _write_pairs(prior: Float, data: CellData, groups: tuple[Group, Group], pairs: Float) -> None:
    """Write variances of pairs of places (places, sender's places) to all orientations."""
    group, sender_group = groups
    is_diagonal = data.is_symmetric and group is sender_group
    if is_diagonal:
        pairs = np.float32(0.5) * (pairs + pairs.T)
    shape = (group.orientations, group.places, sender_group.orientations, sender_group.places)
    block = np.broadcast_to(pairs[None, :, None], shape).reshape(
        group.orientations * group.places, sender_group.orientations * sender_group.places
    )
    prior[group.rows, sender_group.rows] = block
    if data.is_symmetric and not is_diagonal:
        prior[sender_group.rows, group.rows] = block.T


def learn_prior(data: CellData) -> Float:
    """Learn V, (m, n), from the most probable X for the initial prior, and from its uncertainty.

    The expected squares of the entries are averaged over the orientations and the neighbours of a
    pair of places, and drawn towards the mean of all pairs of the same two scales at about the same
    distance, each half octave of it.
    """
    from scipy.ndimage import uniform_filter

    prior = initial_prior(data)
    exchange = DenseExchange(prior, data.light, data.is_symmetric)
    posterior = Posterior.of(data, prior, exchange)
    core = posterior.solve(data.observed, _ITERATIONS).core
    if data.is_symmetric:
        core = core + core.T
        core[np.diag_indices(len(core))] /= 2
    energy = np.square(core) + _remaining_variance(posterior, prior)
    variance = np.empty_like(energy)
    for group, sender_group in data.scale_pairs():
        pairs = (
            energy[group.rows, sender_group.rows]
            .reshape(
                group.orientations, group.places, sender_group.orientations, sender_group.places
            )
            .mean(axis=(0, 2))
        )
        grid = (*group.grid, *sender_group.grid)
        smooth = uniform_filter(pairs.reshape(grid), size=(1, 3, 3, 1, 3, 3), mode="nearest")
        pairs = (pairs + smooth.reshape(pairs.shape)) / 2
        distances = data.distances(group, sender_group)
        half_octave: NDArray[np.int64] = (2 * np.log2(1 + distances)).astype(int)
        count = np.maximum(np.bincount(half_octave.ravel()), 1)
        typical = np.bincount(half_octave.ravel(), pairs.ravel()) / count
        entries = group.orientations * sender_group.orientations
        drawn = (entries * pairs + typical[half_octave]) / (entries + 1)
        _write_pairs(variance, data, (group, sender_group), drawn.astype(np.float32))
    return _significant(data, variance)


def _remaining_variance(posterior: Posterior, prior: Float) -> Float:
    """Approximate the variance of each entry of X that the pictures leave, (m, n).

    Each group of wavelets is taken as independent of the others. On coaxial rigs an entry is
    measured by its row and by its column; their certainties add up.
    """
    data = posterior.data
    explained = np.empty_like(prior)
    for inverses, group in zip(posterior.inverses, data.place_groups, strict=True):
        for inverse, rows in zip(inverses, group, strict=True):
            explained[rows] = np.einsum("np,np->n", data.light @ inverse, data.light)
    share = np.maximum(1 - prior * explained, np.float32(_LEAST_UNCERTAINTY))
    certainty = 1 / (prior * share)
    if data.is_symmetric:
        before = 1 / prior
        certainty = np.maximum(certainty + certainty.T - before, before)
    remaining: Float = 1 / certainty
    return remaining


def _significant(data: CellData, prior: Float) -> Float:
    """Set the prior variances to 0 that together explain at most 1 % of the expected light.

    In the pictures the prior expects the energy ``V |l_w|^2`` of a pair; on a coaxial rig, the sum
    of the energies in both directions.
    """
    power = np.square(data.light).sum(axis=1)
    expected = prior * (power + power[:, None] if data.is_symmetric else power)
    least = threshold_below(expected, _INSIGNIFICANT * float(expected.sum(dtype=np.float64)))
    significant: Float = np.where(expected >= least, prior, 0)
    return significant


def threshold_below(values: Float, total: float) -> float:
    """Compute a threshold such that all values below it add up to at most `total`.

    Values, at least 0, are sorted into classes of 1/128 of an octave by the leading bits of their
    float32 representation; sorting all of them would take ten times as long.
    """
    classes = np.ascontiguousarray(values, np.float32).view(np.int32).ravel() >> _CLASS_BITS
    sums = np.cumsum(np.bincount(classes, values.ravel()))
    first = int(np.searchsorted(sums, total, side="right"))
    return float(np.array(first << _CLASS_BITS, np.int32).view(np.float32))
