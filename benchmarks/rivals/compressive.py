"""Compressive sensing: sparse rows of T from random patterns of on and off.

P. Peers et al., *Compressive light transport sensing*, ACM Trans. Graphics 28 (2009); P. Sen and
S. Darabi, *Compressive dual photography*, Computer Graphics Forum 28 (2009).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from benchmarks.rivals.signs import as_light, random_signs, trimmed_mean
from rfpipe.array_types import Double, Float
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError
from rfpipe.methods.base import MEMORY_BYTES, Forecast, LevelImages, Options, StateArrays
from rfpipe.methods.brute_force import BruteForce, ScanState
from rfpipe.methods.images import planar_batches, rounding
from rfpipe.methods.states import level_row
from rfpipe.patterns import Schedule

if TYPE_CHECKING:
    from scipy.sparse import csr_array


LARGEST_DOMAIN = 64 * 64
"""Rays of the largest camera or projector: the recovery's time grows with the product of pixels,
rays, patterns and atoms."""

_SEED = 2009
# Default number of patterns: a fraction of the rays, with a minimum for small domains.
_RAYS_PER_PATTERN, _FEWEST = 8, 32
# Measurements for each atom of a row. Where more would be taken the row is not sparse.
_MEASUREMENTS_PER_ATOM = 4


class CompressiveOptions(Options):
    """Options of compressive sensing."""

    patterns: int = Field(
        0,
        ge=0,
        le=1_000_000,
        description="Patterns to show at most, 0 to 1000000; 0 leaves it to the method.",
    )


@dataclass(frozen=True)
class CompressiveState(ScanState):
    """The state of compressive sensing: level 0 is the floodlit image, 1 all random patterns.

    Its matrix is zero before the floodlit image, and has that image's light spread over all rays
    after it.

    Attributes
    ----------
    floodlit, variance : ndarray of float32, shape (C, camera rays)
        The floodlit image and its variance.
    """

    options: CompressiveOptions
    floodlit: Float
    variance: Float

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the matrix, the floodlit image and the table of levels."""
        arrays = {"matrix": self.matrix, "floodlit": self.floodlit, "variance": self.variance}
        return StateArrays(arrays, {"rows": list(self.rows)})

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore the state after the last of the levels."""
        if not levels:
            return start
        last = levels[-1]
        return replace(start, rows=tuple(last.attributes["rows"]), **last.arrays)


class Compressive(BruteForce):
    """Compressive sensing of the rows of ``T``, as a `Method`.

    The patterns are the published ones of compressive dual photography, on and off at random; the
    floodlit image makes signs of them, which are less alike. A row is taken to be a sum of few
    atoms: Haar wavelets, as published, and single rays, which hold direct light in one atom where
    wavelets take dozens. Nothing is subtracted beforehand. Atoms are added until the residual of a
    pixel's measurements is their noise.
    """

    name = "compressive"
    title = "Compressive sensing"
    colour = "#4c8c4a"
    marker = "v"
    Options = CompressiveOptions
    trades = "patterns"
    trials = (50, 100, 200, 500)
    line = "-"

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: CompressiveOptions
    ) -> Forecast:
        """Forecast the number of the options, or one pattern for each `_RAYS_PER_PATTERN` rays."""
        patterns = pattern_count(projector.size, options.patterns)
        return self.forecast_of(camera, channels, patterns, patterns)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: CompressiveOptions
    ) -> CompressiveState:
        """Return the state before the floodlit image.

        Raises
        ------
        InputError
            If camera or projector has more rays than `LARGEST_DOMAIN`.
        """
        if max(camera.size, projector.size) > LARGEST_DOMAIN:
            raise InputError(
                f"compressive sensing of {projector.size} projector rays by {camera.size} camera "
                f"rays: it recovers up to {LARGEST_DOMAIN} rays, beyond which it would take "
                "hours; use dual or symmetric photography"
            )
        matrix = np.zeros((channels, camera.size, projector.size), np.float32)
        dark = np.zeros(matrix.shape[:2], np.float32)
        return CompressiveState(camera, projector, channels, options, matrix, dark, dark)

    def next_schedule(self, state: CompressiveState) -> Schedule | None:
        """Show the floodlit pattern, then all random ones."""
        shape, rays = state.projector.shape, state.projector.size
        if state.level == 0:
            return Schedule.floodlit(shape)
        if state.level > 1:
            return None
        count = pattern_count(rays, state.options.patterns) - 1
        weights = as_light(random_signs(count, rays, _SEED, state.level), shape)
        return Schedule(state.level, shape, count, weights=weights)

    def refine(
        self, state: CompressiveState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> CompressiveState:
        """Keep the floodlit image; then recover the matrix."""
        channels, pixels, rays = state.matrix.shape
        count = images.schedule.count
        measured, variance = (np.empty((channels, count, pixels), np.float32) for _ in range(2))
        for part, radiance, spread in planar_batches(images, channels, pixels):
            measured[:, part], variance[:, part] = radiance, spread
        atoms, new = 0, {}
        if state.level == 0:
            floodlit, variance = measured[:, 0], variance[:, 0]
            matrix = np.repeat(floodlit[..., None] / np.float32(rays), rays, axis=2)
            new = {"floodlit": floodlit, "variance": variance, "matrix": matrix}
        else:
            floodlit = state.floodlit[:, None]
            measured = np.concatenate([floodlit, 2 * measured - floodlit], axis=1)
            # the floodlit image's noise is common to all and the least by far; not its rounding
            variance = 4 * variance + rounding(floodlit)
            # which is known so well that no sparse signal would fit it: it weighs as one of them
            first = np.maximum(state.variance, variance.mean(axis=1))[:, None]
            variance = np.concatenate([first, variance], axis=1)
            signs = np.concatenate(
                [np.ones((1, rays), np.float32), random_signs(count, rays, _SEED, state.level)]
            )
            matrix, atoms = recover(signs, measured, variance, state.projector)
            new = {"matrix": matrix}
        row = level_row(state.level, count, nodes=pixels * channels, scalar=atoms)
        return replace(state, rows=(*state.rows, row), **new)


def pattern_count(rays: int, requested: int) -> int:
    """Return the number of patterns: the requested one, or a default for the projector's rays."""
    return requested or max(rays // _RAYS_PER_PATTERN, _FEWEST)


def recover(
    signs: Float, measured: Float, variance: Float, projector: RayDomain
) -> tuple[Float, int]:
    """Recover the rows of T from what each camera pixel saw under signed patterns.

    Parameters
    ----------
    signs : ndarray of float32, shape (P, projector rays)
    measured, variance : ndarray of float32, shape (C, P, camera rays)
        ``T q`` and its variance.
    projector : RayDomain

    Returns
    -------
    matrix : ndarray of float32, shape (C, camera rays, projector rays)
    atoms : int
        How many it is made of.
    """
    dictionary = rays_and_wavelets(projector)
    projected = dictionary @ signs.T.astype(np.float64)
    max_atoms = max(1, len(signs) // _MEASUREMENTS_PER_ATOM)
    matrix = np.empty((len(measured), measured.shape[2], projector.size), np.float32)
    atoms = 0
    for channel, (values, spread) in enumerate(zip(measured, variance, strict=True)):
        weights = 1 / np.sqrt(trimmed_mean(spread))
        chosen, factors = pursue(
            projected * weights, values.T * weights, (spread.T * weights**2).sum(axis=1), max_atoms
        )
        matrix[channel] = _sum_of_atoms(chosen, factors, dictionary.shape[0]) @ dictionary
        atoms += int(np.count_nonzero(chosen >= 0))
    return matrix, atoms


def _sum_of_atoms(
    chosen: NDArray[np.int64], factors: NDArray[np.float64], atoms: int
) -> NDArray[np.float64]:
    """Return each row's factors of all atoms, (rows, atoms)."""
    dense = np.zeros((len(chosen), atoms))
    row, place = np.nonzero(chosen >= 0)
    dense[row, chosen[row, place]] = factors[row, place]
    return dense


# An atom this close to the span of the chosen atoms would only add rounding errors.
_DEPENDENT = 1e-6
# Memory of the orthonormal bases of signals that are worked on together.
_BATCH_BYTES = 128 * 2**20


def rays_and_wavelets(domain: RayDomain) -> csr_array[Any]:
    """Return a dictionary of single rays and Haar wavelets.

    The wavelets belong to the domain's block tree, each block's children halved in turn, so
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
    atoms: Double, signals: Double, allowed: Double, max_atoms: int
) -> tuple[NDArray[np.int64], Double]:
    """Explain signals by few atoms each, by orthogonal matching pursuit.

    Each step adds the atom that is nearest to the residual of a signal, and projects the signal
    onto all chosen atoms. J. A. Tropp and A. C. Gilbert, *Signal recovery from random measurements
    via orthogonal matching pursuit*, IEEE Trans. Information Theory 53 (2007).

    Parameters
    ----------
    atoms : ndarray of float64, shape (a, m)
        Of any norm; zero atoms are never chosen.
    signals : ndarray of float64, shape (n, m)
    allowed : ndarray of float64, shape (n,)
        Squared norm below which the residual of a signal counts as noise.
    max_atoms : int
        Largest number of atoms of a signal.

    Returns
    -------
    chosen : ndarray of int64, shape (n, max_atoms)
        Atoms of each signal, -1 where there are fewer.
    coefficients : ndarray of float64, shape (n, max_atoms)
        Their factors, 0 there.
    """
    norms = np.maximum(np.linalg.norm(atoms, axis=1), np.finfo(np.float64).tiny)
    units = atoms / norms[:, None]
    chosen = np.full((len(signals), max_atoms), -1, np.int64)
    coefficients = np.zeros((len(signals), max_atoms))
    step = max(1, _BATCH_BYTES // (max(max_atoms, 1) * signals.shape[1] * signals.itemsize))
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
    count, max_atoms = chosen.shape
    residual = signals.copy()
    basis = np.zeros((count, max_atoms, signals.shape[1]))
    # Of the chosen atoms in the basis: upper triangular, the identity where nothing is chosen.
    shares = np.tile(np.eye(max_atoms), (count, 1, 1))
    onto = np.zeros((count, max_atoms))
    active = np.arange(count)
    for step in range(max_atoms):
        active = active[np.square(residual[active]).sum(axis=1) > allowed[active]]
        if not len(active):
            break
        atom = np.abs(residual[active] @ units.T).argmax(axis=1)
        chosen_atoms, remainder = basis[active, :step], units[atom]
        share = np.zeros((len(active), step))
        for _ in range(2):  # once more for what rounding left
            overlap = np.einsum("kjm,km->kj", chosen_atoms, remainder)
            remainder = remainder - np.einsum("kj,kjm->km", overlap, chosen_atoms)
            share += overlap
        length = np.linalg.norm(remainder, axis=1)
        new = length > _DEPENDENT
        active, atom, length, share = active[new], atom[new], length[new], share[new]
        direction = remainder[new] / length[:, None]
        chosen[active, step] = atom
        basis[active, step] = direction
        shares[active, :step, step], shares[active, step, step] = share, length
        onto[active, step] = np.einsum("km,km->k", residual[active], direction)
        residual[active] -= onto[active, step, None] * direction
    coefficients[:] = np.linalg.solve(shares, onto[..., None])[..., 0]
