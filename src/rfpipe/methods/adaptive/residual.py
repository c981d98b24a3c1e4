"""What a model of the light leaves of all pictures together, whoever asked for them.

The transport is ``T = M + F K F + diag(d)``: M is any model's, F the root of the floodlit image,
and K symmetric, of any sign, ``K = W^T C W`` with Haar wavelets W. The entries of C are independent
normal deviates whose variances are learned from the pictures. Light isn't negative, which says more
of K than many pictures do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.adaptive.estimate import relit
from rfpipe.methods.adaptive.smooth_fit import conjugate_gradients
from rfpipe.methods.base import Float, LevelImages
from rfpipe.methods.images import Pictures, planar_batches
from rfpipe.methods.states import joined
from rfpipe.transport.base import Transport
from rfpipe.transport.wavelet import Cells, Group, Haar, WaveletTransport, cell_side

MOST_CELLS = 4096
"""Of so many cells, the covariance of all pairs takes 64 MiB."""

# How often light is made to be not negative, and iterations of each solution.
_CLIPPED, _ITERATIONS = 8, 8
# Of more pictures, those are fitted that the model predicts worst: time grows with their square,
# and so does memory, to 1.3 GB with as many cells as there may be.
_MOST_PICTURES = 512
_ROUNDING = float(np.finfo(np.float32).eps)
_TINY = float(np.finfo(np.float32).tiny)


def cells_of(shape: tuple[int, ...], most: int = MOST_CELLS) -> Cells:
    """Return the cells in which a ray domain is looked at, at most so many."""
    return Cells(shape, cell_side(shape, most))


@dataclass(frozen=True)
class CellPictures:
    """Pictures of patterns (P, N), summed over cells, (P, C, cells); see `Canvas.reduced`.

    The variance is infinite where a cell has no known pixel.
    """

    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float


class Canvas:
    """What all pictures share: cells, the floodlit image (C, N), and the pixels shown, (N,)."""

    def __init__(self, cells: Cells, floodlit: Float, known: NDArray[np.bool_]) -> None:
        self.cells, self.known = cells, known
        light = np.maximum(floodlit, 0)
        self.brightest: Float = light.max(axis=1)
        # dim pixels may exchange light, too
        lifted = light + np.float32(0.02) * light.mean(axis=1, keepdims=True)
        # half of what a surface returns goes with the light that it gets, half with what it sends
        root = np.power(lifted, np.float32(0.5))
        mean = root.mean(axis=1, keepdims=True)
        self.factor: Float = np.divide(root, mean, out=np.zeros_like(root), where=mean > 0)
        """F, float32 (C, N), of mean 1."""

    @classmethod
    def of(cls, shape: tuple[int, ...], pictures: Pictures, most: int = MOST_CELLS) -> Canvas:
        """Return the canvas of pictures of a ray domain; a channel of noise alone is dark."""
        shining = [pictures.channel(index).shine() for index in range(pictures.channels)]
        floodlit = pictures.floodlit * np.reshape(shining, (-1, 1))
        return cls(cells_of(shape, most), floodlit, pictures.known)

    @cached_property
    def weight(self) -> Float:
        """Sums of F^2 over the known pixels of each cell, (C, cells)."""
        return np.ascontiguousarray(self.cells.total(self.factor**2 * self.known).T)

    def reduced(self, images: Float) -> Float:
        """Return the least-squares fit of F times a constant in each cell to images (P, C, N).

        float32 (P, C, cells); 0 where a cell has no known pixel.
        """
        planes = [
            self._over(weight, images[:, c], self.factor[c] * self.known)
            for c, weight in enumerate(self.weight)
        ]
        return np.stack(planes, axis=1)

    def taken(self, lit: NDArray[np.bool_], radiance: Float, variance: Float) -> CellPictures:
        """Return pictures (P, C, N) of patterns (P, N), summed over cells."""
        variance = np.where(self.known, variance, 0)
        spread = [
            self._over(weight**2, variance[:, c], np.square(self.factor[c]))
            for c, weight in enumerate(self.weight)
        ]
        summed = np.where(self.weight > 0, np.stack(spread, axis=1), np.float32(np.inf))
        return CellPictures(lit, self.reduced(radiance), summed)

    def read(self, images: LevelImages, first: int = 0) -> CellPictures:
        """Read a level's images from one on, a few at a time, summed over cells."""
        channels, rays = self.factor.shape
        lit = images.schedule.batch(first, images.schedule.count).reshape(-1, rays) > 0
        parts = [
            self.taken(lit[part], np.moveaxis(radiance, 0, 1), np.moveaxis(variance, 0, 1))
            for part, radiance, variance in planar_batches(images, channels, rays, first)
        ]
        return joined(parts, axis=0)

    def _over(self, weight: Float, images: Float, factor: Float) -> Float:
        sums = self.cells.total(images * factor).T
        return np.divide(sums, weight, out=np.zeros(sums.shape, np.float32), where=weight > 0)


@dataclass(frozen=True)
class Residual:
    """What a model leaves, as `WaveletTransport` has it: pairs (2, pairs), cores (C, pairs)."""

    pairs: NDArray[np.int32]
    cores: Float

    def transport(self, canvas: Canvas) -> WaveletTransport:
        """Return it as a transport."""
        cells = canvas.cells
        arrays = {
            "side": np.array([cells.side], np.int32),
            "factor": canvas.factor,
            "pairs": self.pairs,
            "cores": self.cores,
        }
        return WaveletTransport(cells.shape, len(canvas.factor), [], arrays)


def residual_of(canvas: Canvas, pictures: CellPictures, model: Transport) -> Residual:
    """Find what a model leaves: the most probable given all pictures, the floodlit one first.

    The model need not be good.
    """
    channels, haar = len(canvas.factor), canvas.cells.haar
    residual = pictures.radiance - _predicted(canvas, pictures.lit, model)
    # a picture may be wrong by a part of the brightest light in any case
    expected = np.square(np.float32(5e-4) * canvas.brightest)
    variance = pictures.variance + expected[:, None]
    telling = _telling(residual, variance)
    lit, observed = pictures.lit[telling], pictures.radiance[telling]
    residual, variance = residual[telling], variance[telling]
    cores = np.zeros((channels, haar.size, haar.size), np.float32)
    weights = np.zeros((channels, haar.size))
    prior: Float | None = None
    # the brightest channel tells most of the ways that light takes; others take the same
    brightest = int(np.argmax(canvas.brightest))
    for channel in sorted(range(channels), key=lambda index: index != brightest):
        share = canvas.brightest[channel] / max(canvas.brightest[brightest], _TINY)
        if not share > 0:
            continue
        light = canvas.cells.total(lit * canvas.factor[channel])
        posterior = Posterior(haar, light, residual[:, channel].T, variance[:, channel].T)
        if prior is None:
            prior = posterior.guessed()
            for _ in range(2):
                posterior.prepare(prior)
                posterior.solve(posterior.observed, _ITERATIONS)
                prior = posterior.relearned()
        matrix = _not_negative(posterior, prior * share**2, _between(canvas, model, channel))
        half = haar.forward(matrix)
        cores[channel] = haar.forward(np.ascontiguousarray(half.T))
        energy = np.square(observed[:, channel], dtype=np.float64).sum(axis=1).mean()
        weights[channel] = np.square(posterior.light, dtype=np.float64).mean(axis=1) / energy
    return _kept(cores, weights)


def _telling(left: Float, variance: Float) -> NDArray[np.int64]:
    """Return which pictures to fit: all, or the first and those that a model predicts worst."""
    if len(left) <= _MOST_PICTURES:
        return np.arange(len(left))
    known = np.isfinite(variance) & (variance > 0)
    share = np.divide(np.square(left), variance, where=known, out=np.zeros_like(left))
    worst = np.argsort(-share[1:].sum(axis=(1, 2), dtype=np.float64), kind="stable")
    return np.concatenate([[0], np.sort(worst[: _MOST_PICTURES - 1]) + 1])


def _not_negative(posterior: Posterior, prior: Float, model: Float) -> Float:
    """Return K, (cells, cells), that takes no more light from between cells than is there.

    Clip what is negative, find what the pictures then lack, and again. Noise would be fitted the
    more often the more often that is done; so pictures are taken for as much noisier.
    """
    posterior.prepare(prior)
    posterior.solve(posterior.observed, 2 * _ITERATIONS)
    matrix, direct = posterior.matrix(), posterior.direct
    posterior.prepare(prior, _CLIPPED)
    between = ~np.eye(len(matrix), dtype=np.bool_)
    for _ in range(_CLIPPED):
        np.maximum(matrix, -model, out=matrix, where=between)
        predicted = matrix @ posterior.cells + direct[:, None] * posterior.cells
        posterior.solve(posterior.left(predicted), _ITERATIONS)
        matrix += posterior.matrix()
        direct = direct + posterior.direct
    return matrix


def _between(canvas: Canvas, model: Transport, channel: int) -> Float:
    """Return the light that a model has between cells, over F on both sides, (cells, cells)."""
    cells, factor, weight = canvas.cells, canvas.factor[channel], canvas.weight[channel]
    light = cells.total(np.square(factor)[None])[:, 0]
    sent = cells.shared_out(factor, light)
    received = cells.shared_out(factor * canvas.known, weight)
    matrix = model.between(received, sent, channel)
    return np.float32(0.5) * (matrix + matrix.T)


def _predicted(canvas: Canvas, lit: NDArray[np.bool_], model: Transport) -> Float:
    """Return a model's pictures of patterns, as `CellPictures.radiance`."""
    parts = [lit[first : first + 64] for first in range(0, len(lit), 64)]
    return np.concatenate([canvas.reduced(relit(model, part)) for part in parts])


def _kept(cores: Float, weights: NDArray[np.float64]) -> Residual:
    """Keep the cores without which a picture would change by more than a part of its norm."""
    first, second = np.triu_indices(cores.shape[1])
    both = weights[:, first] + np.where(first != second, weights[:, second], 0)
    entries = cores[:, first, second]
    change = (np.square(entries) * both).max(axis=0)
    rising = np.sort(change)
    dropped = np.searchsorted(np.cumsum(rising), 5e-4**2, side="right")
    kept = np.flatnonzero(change >= np.append(rising, np.inf)[dropped])
    pairs = np.stack([first[kept], second[kept]]).astype(np.int32)
    return Residual(pairs, np.ascontiguousarray(entries[:, kept]))


class Posterior:
    """K of one channel given what a model leaves of pictures of cells, over F.

    Parameters
    ----------
    haar : Haar
    light : ndarray of float32, shape (cells, P)
        Sums of the patterns times F.
    observed, variance : ndarray of float32, shape (cells, P)
        The variance is infinite where nothing is known.
    """

    def __init__(self, haar: Haar, light: Float, observed: Float, variance: Float) -> None:
        self.haar, self.cells = haar, np.ascontiguousarray(light)
        self._known = np.isfinite(variance)
        self.observed = np.where(self._known, observed, 0)
        self._variance = np.where(self._known, variance, 0)
        certainty = np.divide(
            1, self._variance, where=self._known, out=np.zeros_like(self.observed)
        )
        self._noise = 1 / max(float(certainty.mean(dtype=np.float64)), _TINY)
        self.light = haar.forward(self.cells)
        lit = max(float(np.square(self.cells, dtype=np.float64).mean()), _TINY)
        # variance of what cells send back directly: a part of that of what the model leaves
        self._direct = np.float32(0.02 * self.observed.var(dtype=np.float64) / lit)
        self._alike = [rows for group in haar.groups for rows in group.alike()]

    def left(self, predicted: Float) -> Float:
        """Return what predicted pictures (cells, P) leave of those taken; 0 if unknown."""
        residual: Float = np.where(self._known, self.observed - predicted, 0)
        return residual

    def guessed(self) -> Float:
        """Return variances of C before any fit, (size, size): falling with the distance's square.

        The unit of distance is half a cell.
        """
        haar = self.haar
        changing = self.light - self.light.mean(axis=1, keepdims=True)
        unit = np.square(changing, dtype=np.float64).sum(axis=0).mean() / len(changing)
        energy = np.square(self.observed, dtype=np.float64).sum(axis=0).mean()
        variance = np.empty((haar.size, haar.size), np.float32)
        for one, other in _pairs(haar):
            apart = 1 + np.square(_distances(one, other) / 0.5)
            each = (one.side * other.side) ** 2 / apart
            _spread(variance, one, other, each.astype(np.float32))
        total = float(energy / max(unit, _TINY))
        variance *= np.float32(total / variance.sum(dtype=np.float64))
        return variance

    def prepare(self, prior: Float, times: int = 1) -> None:
        """Take a prior (size, size), and pictures whose variances are some times larger."""
        self.prior, self._times = prior, np.float32(times)
        count = self.light.shape[1]
        self._roots = np.empty((len(self._alike), count, count), np.float32)
        self._inverses = np.empty_like(self._roots)
        for index, rows in enumerate(self._alike):
            scaled = self.light * np.sqrt(prior[rows].mean(axis=0))[:, None]
            # of a matrix and its own transpose, BLAS finds one half
            covariance = (scaled.T @ scaled).astype(np.float64)
            # float32 sums of much brighter light round more than that
            rounding = _ROUNDING * count * float(covariance.diagonal().max())
            covariance[np.diag_indices(count)] += times * self._noise + rounding
            root = np.linalg.inv(np.linalg.cholesky(covariance)).astype(np.float32)
            self._roots[index], self._inverses[index] = root, root.T @ root

    def relearned(self) -> Float:
        """Return the variances of C that its last solution, and its uncertainty, suggest.

        Those of a pair of places are averaged over orientations and with their neighbours', and
        drawn towards the mean of all pairs of the same two scales at about the same distance.
        """
        from scipy.ndimage import uniform_filter

        energy = np.empty_like(self.prior)
        for root, rows in zip(self._roots, self._alike, strict=True):
            energy[rows] = np.square(root @ self.light.T).sum(axis=0)
        # rows tell of an entry, and so do columns: either leaves a part of its variance, at least
        # a ten-thousandth, and certainties add up
        certainty = 1 / (self.prior * np.maximum(1 - self.prior * energy, np.float32(1e-4)))
        before = 1 / self.prior
        energy = np.square(self.core) + 1 / np.maximum(certainty + certainty.T - before, before)
        variance = np.empty_like(energy)
        for one, other in _pairs(self.haar):
            part = energy[one.rows, other.rows].reshape(
                one.orientations, one.places, other.orientations, other.places
            )
            pairs = part.mean(axis=(0, 2))
            grid = (*one.grid, *other.grid)
            smooth = uniform_filter(pairs.reshape(grid), size=(1, 3, 3, 1, 3, 3), mode="nearest")
            pairs = (pairs + smooth.reshape(pairs.shape)) / 2
            half_octave: NDArray[np.int64] = (2 * np.log2(1 + _distances(one, other))).astype(int)
            count = np.maximum(np.bincount(half_octave.ravel()), 1)
            typical = np.bincount(half_octave.ravel(), pairs.ravel()) / count
            each = one.orientations * other.orientations
            drawn = (each * pairs + typical[half_octave]) / (each + 1)
            _spread(variance, one, other, drawn.astype(np.float32))
        floor: Float = np.maximum(variance, np.float32(1e-10) * variance.max())
        return floor

    def solve(self, observed: Float, iterations: int) -> None:
        """Find what is most probable given what is left of pictures (cells, P), 0 if unknown.

        That is C, `core`, and a diagonal for what cells send back directly, `direct`, by conjugate
        gradients in the space of the pictures.
        """
        self._applied(
            conjugate_gradients(
                self._applied, observed, self._preconditioned, None, 1e-3, iterations, weighed=False
            )
        )

    def matrix(self) -> Float:
        """Return K of the last solution, (cells, cells)."""
        half = self.haar.inverse(self.core)
        return self.haar.inverse(np.ascontiguousarray(half.T))

    def _applied(self, dual: Float) -> Float:
        """Apply the covariance of the pictures; the solution that goes with it is left behind."""
        from rfpipe.methods.adaptive.kernels import symmetric_product

        core: Float = self.haar.forward(dual) @ self.light.T
        symmetric_product(core, self.prior)
        self.core = core
        self.direct = self._direct * np.einsum("cm,cm->c", dual, self.cells)
        pictures = self.haar.inverse(core @ self.light)
        pictures += self.direct[:, None] * self.cells
        pictures += self._times * self._variance * dual
        pictures *= self._known
        return pictures

    def _preconditioned(self, rest: Float) -> Float:
        coefficients = self.haar.forward(rest)
        for inverse, rows in zip(self._inverses, self._alike, strict=True):
            coefficients[rows] = coefficients[rows] @ inverse
        return self.haar.inverse(coefficients) * self._known


def _pairs(haar: Haar) -> Iterator[tuple[Group, Group]]:
    """Yield each pair of scales once."""
    for index, one in enumerate(haar.groups):
        for other in haar.groups[index:]:
            yield one, other


def _spread(variance: Float, one: Group, other: Group, each: Float) -> None:
    """Write the variances of pairs of places for all orientations, both ways."""
    if one is other:
        each = np.float32(0.5) * (each + each.T)
    shape = (one.orientations, one.places, other.orientations, other.places)
    whole = np.broadcast_to(each[None, :, None], shape).reshape(
        one.orientations * one.places, other.orientations * other.places
    )
    variance[one.rows, other.rows] = whole
    if one is not other:
        variance[other.rows, one.rows] = whole.T


def _distances(one: Group, other: Group) -> Float:
    """Distances of places in cells, whichever views they are in, (places, places)."""
    apart = one.centres()[:, None] - other.centres()
    distance: Float = np.hypot(apart[..., 0], apart[..., 1])
    return distance
