"""Sparse recovery: a dictionary of rays and wavelets, and orthogonal matching pursuit."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["pursue", "rays_and_wavelets"]

Double = NDArray[np.float64]

# An atom within so much of the span of those chosen before adds nothing but rounding.
_DEPENDENT = 1e-6
# Memory of the orthonormal bases of signals that are worked on together.
_BATCH_BYTES = 128 * 2**20


def rays_and_wavelets(domain: RayDomain) -> csr_array[Any]:
    """Return a dictionary of single rays and Haar wavelets.

    The wavelets are those of the domain's block tree, each block's children halved in turn, so
    that they are orthonormal for any size and for stacks of views.

    Parameters
    ----------
    domain : RayDomain
        Of n rays.

    Returns
    -------
    csr_array of float64, shape (2 n, n)
        An atom a row, of norm 1: the n rays, then the constant and the n - 1 wavelets.
    """
    from scipy.sparse import coo_array, csr_array, eye_array, vstack

    rays = domain.size
    tree = BlockTree(domain)
    rows, columns = [np.zeros(rays, np.int64)], [np.arange(rays)]
    values = [np.full(rays, rays**-0.5)]
    for atom, (first, middle, last) in enumerate(_splits(tree), 1):
        sizes = np.array([middle - first, last - middle])
        heights = np.array([1.0, -1.0]) * np.sqrt(sizes[::-1] / (sizes * sizes.sum()))
        rows.append(np.full(last - first, atom))
        columns.append(tree.order[first:last])
        values.append(np.repeat(heights, sizes))
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))
    wavelets = coo_array(entries, shape=(rays, rays))
    return csr_array(vstack([eye_array(rays), wavelets]))


def _splits(tree: BlockTree) -> Iterator[tuple[int, int, int]]:
    """Yield each run of tree positions that is halved: its start, middle and end."""
    for level, child_starts in enumerate(tree.child_starts):
        bounds = tree.starts[level + 1]
        for first, last in pairwise(child_starts):
            yield from _halves(bounds[first : last + 1])


def _halves(bounds: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    if len(bounds) > 2:
        middle = len(bounds) // 2
        yield int(bounds[0]), int(bounds[middle]), int(bounds[-1])
        yield from _halves(bounds[: middle + 1])
        yield from _halves(bounds[middle:])


def pursue(
    atoms: Double, signals: Double, allowed: Double, most: int
) -> tuple[NDArray[np.int64], Double]:
    """Explain signals by few atoms each, by orthogonal matching pursuit.

    Each step takes the atom that is nearest to what is left of a signal, and projects the signal
    onto all those taken. J. A. Tropp and A. C. Gilbert, *Signal recovery from random measurements
    via orthogonal matching pursuit*, IEEE Trans. Information Theory 53 (2007).

    Parameters
    ----------
    atoms : ndarray of float64, shape (a, m)
        Of any norm; what is zero is never taken.
    signals : ndarray of float64, shape (n, m)
    allowed : ndarray of float64, shape (n,)
        Squared norm at which what is left of a signal counts as noise.
    most : int
        Atoms that a signal may take.

    Returns
    -------
    chosen : ndarray of int64, shape (n, most)
        Atoms of each signal, -1 where there are fewer.
    coefficients : ndarray of float64, shape (n, most)
        Their factors, 0 there.
    """
    norms = np.maximum(np.linalg.norm(atoms, axis=1), np.finfo(np.float64).tiny)
    units = atoms / norms[:, None]
    chosen = np.full((len(signals), most), -1, np.int64)
    coefficients = np.zeros((len(signals), most))
    step = max(1, _BATCH_BYTES // (max(most, 1) * signals.shape[1] * signals.itemsize))
    for first in range(0, len(signals), step):
        part = slice(first, first + step)
        _pursue_some(units, signals[part], allowed[part], chosen[part], coefficients[part])
    coefficients /= norms[chosen]
    return chosen, coefficients


def _pursue_some(
    units: Double,
    signals: Double,
    allowed: Double,
    chosen: NDArray[np.int64],
    coefficients: Double,
) -> None:
    """Fill in the atoms of some signals, and their factors."""
    count, most = chosen.shape
    residual = signals.copy()
    basis = np.zeros((count, most, signals.shape[1]))
    # Of the chosen atoms in the basis: upper triangular, the identity where nothing is chosen.
    shares = np.tile(np.eye(most), (count, 1, 1))
    onto = np.zeros((count, most))
    active = np.arange(count)
    for step in range(most):
        active = active[np.square(residual[active]).sum(axis=1) > allowed[active]]
        if not len(active):
            break
        atom = np.abs(residual[active] @ units.T).argmax(axis=1)
        taken, rest = basis[active, :step], units[atom]
        share = np.zeros((len(active), step))
        for _ in range(2):  # once more for what rounding left
            again = np.einsum("kjm,km->kj", taken, rest)
            rest = rest - np.einsum("kj,kjm->km", again, taken)
            share += again
        length = np.linalg.norm(rest, axis=1)
        new = length > _DEPENDENT
        active, atom, length, share = active[new], atom[new], length[new], share[new]
        direction = rest[new] / length[:, None]
        chosen[active, step] = atom
        basis[active, step] = direction
        shares[active, :step, step], shares[active, step, step] = share, length
        onto[active, step] = np.einsum("km,km->k", residual[active], direction)
        residual[active] -= onto[active, step, None] * direction
    coefficients[:] = np.linalg.solve(shares, onto[..., None])[..., 0]
