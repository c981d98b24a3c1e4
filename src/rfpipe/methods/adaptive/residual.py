"""What a model of the light leaves of all pictures together, whoever asked for them.

The transport of a coaxial rig is ``T = M + F K F + diag(d)``: M is any model's, F the root of the
floodlit image, and K symmetric, of any sign, ``K = W^T C W`` with Haar wavelets W; of another rig
``T = M + F K G``, where G is the root of what the projector's rays send, and K isn't symmetric. The
entries of C are independent normal deviates whose variances are learned from the pictures. Light
isn't negative, which says more of K than many pictures do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.adaptive.estimate import relit
from rfpipe.methods.adaptive.smooth_fit import conjugate_gradients
from rfpipe.methods.base import Float, LevelImages
from rfpipe.methods.images import Pictures, planar_batches
from rfpipe.methods.states import joined
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport, sparse_arrays
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
    """What all pictures share.

    Parameters
    ----------
    cells : Cells
        Of the camera.
    floodlit : ndarray of float32, shape (C, M)
    known : ndarray of bool, shape (M,)
        The pixels shown.
    """

    def __init__(self, cells: Cells, floodlit: Float, known: NDArray[np.bool_]) -> None:
        self.cells, self.known = cells, known
        self.brightest: Float = np.maximum(floodlit, 0).max(axis=1)
        self.factor = root_of(floodlit)

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
        lit = images.schedule.batch(first, images.schedule.count) > 0
        lit = lit.reshape(len(lit), -1)
        parts = [
            self.taken(lit[part], np.moveaxis(radiance, 0, 1), np.moveaxis(variance, 0, 1))
            for part, radiance, variance in planar_batches(images, channels, rays, first)
        ]
        return joined(parts, axis=0)

    def _over(self, weight: Float, images: Float, factor: Float) -> Float:
        sums = self.cells.total(images * factor).T
        return np.divide(sums, weight, out=np.zeros(sums.shape, np.float32), where=weight > 0)


@dataclass(frozen=True)
class Sender:
    """The projector of a rig that isn't coaxial.

    Attributes
    ----------
    cells : Cells
    factor : ndarray of float32, shape (C, N)
        Root of what each ray sends, see `root_of`.
    places : ndarray of float32, shape (cells, 2)
        Row and column, in the camera's cells, of what each cell lights.
    """

    cells: Cells
    factor: Float
    places: Float


@dataclass(frozen=True)
class Residual:
    """What a model leaves: pairs of wavelets (2, pairs), and cores (C, pairs), what they exchange.

    `sent` is `Sender.factor`, (C, 0) of coaxial rigs.
    """

    pairs: NDArray[np.int32]
    cores: Float
    sent: Float

    def transport(self, canvas: Canvas, shape: tuple[int, ...]) -> Transport:
        """Return it as a transport from a projector's ray domain."""
        cells, channels = canvas.cells, len(canvas.factor)
        if not self.sent.size:
            arrays = {
                "side": np.array([cells.side], np.int32),
                "factor": canvas.factor,
                "pairs": self.pairs,
                "cores": self.cores,
            }
            return WaveletTransport(cells.shape, channels, [], arrays)
        from scipy.sparse import csr_array

        lamp, pixels = cells_of(shape), canvas.known.size
        places: Any = (np.ones(self.pairs.shape[1], np.float32), tuple(self.pairs))
        cores = csr_array(places, shape=(cells.haar.size, lamp.haar.size))
        nothing: Any = csr_array((pixels, lamp.of_ray.size), dtype=np.float32)
        arrays = {
            **sparse_arrays("footprints", nothing, [nothing.data] * channels),
            **sparse_arrays("left", cells.functions()),
            **sparse_arrays("right", lamp.functions()),
            **sparse_arrays("cores", cores, list(self.cores)),
            "camera_factor": canvas.factor,
            "projector_factor": self.sent,
        }
        return FootprintTransport(cells.shape, shape, channels, [], arrays)


def root_of(light: Float) -> Float:
    """Return the root of an image (C, rays), of mean 1.

    Half of what a surface returns goes with the light that it gets, half with what it sends.
    """
    bright = np.maximum(light, 0)
    # dim pixels may exchange light, too
    root = np.sqrt(bright + np.float32(0.02) * bright.mean(axis=1, keepdims=True))
    mean = root.mean(axis=1, keepdims=True)
    unit: Float = np.divide(root, mean, out=np.zeros_like(root), where=mean > 0)
    return unit


def residual_of(
    canvas: Canvas, pictures: CellPictures, model: Transport, sender: Sender | None = None
) -> Residual:
    """Find what a model leaves: the most probable given all pictures, the floodlit one first.

    The model need not be good. A rig without a `sender` is coaxial.
    """
    channels, cells = len(canvas.factor), canvas.cells
    lamp, factor = (cells, canvas.factor) if sender is None else (sender.cells, sender.factor)
    residual = pictures.radiance - _predicted(canvas, pictures.lit, model)
    # a picture may be wrong by a part of the brightest light in any case
    expected = np.square(np.float32(5e-4) * canvas.brightest)
    variance = pictures.variance + expected[:, None]
    telling = _telling(residual, variance)
    lit, observed = pictures.lit[telling], pictures.radiance[telling]
    residual, variance = residual[telling], variance[telling]
    cores = np.zeros((channels, cells.haar.size, lamp.haar.size), np.float32)
    weights = np.zeros((channels, lamp.haar.size))
    prior: Float | None = None
    # the brightest channel tells most of the ways that light takes; others take the same
    brightest = int(np.argmax(canvas.brightest))
    for channel in sorted(range(channels), key=lambda index: index != brightest):
        share = canvas.brightest[channel] / max(canvas.brightest[brightest], _TINY)
        if not share > 0:
            continue
        posterior = Posterior(
            cells.haar,
            lamp.total(lit * factor[channel]),
            residual[:, channel].T,
            variance[:, channel].T,
            None if sender is None else (lamp.haar, sender.places),
        )
        if prior is None:
            prior = posterior.guessed()
            for _ in range(2):
                posterior.prepare(prior)
                posterior.solve(posterior.observed, _ITERATIONS)
                prior = posterior.relearned()
        between = _between(canvas, model, channel, sender)
        matrix = _not_negative(posterior, prior * share**2, between)
        half = cells.haar.forward(matrix)
        cores[channel] = lamp.haar.forward(np.ascontiguousarray(half.T)).T
        energy = np.square(observed[:, channel], dtype=np.float64).sum(axis=1).mean()
        weights[channel] = np.square(posterior.light, dtype=np.float64).mean(axis=1) / energy
    sent = np.zeros((channels, 0), np.float32) if sender is None else factor
    return _kept(cores, weights, sent)


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
    between = np.ones(matrix.shape, np.bool_)
    if posterior.symmetric:
        np.fill_diagonal(between, val=False)
    for _ in range(_CLIPPED):
        np.maximum(matrix, -model, out=matrix, where=between)
        posterior.solve(posterior.left(matrix, direct), _ITERATIONS)
        matrix += posterior.matrix()
        direct = direct + posterior.direct
    return matrix


def _between(canvas: Canvas, model: Transport, channel: int, sender: Sender | None) -> Float:
    """Return the light that a model has between cells, over F on both sides, (cells, cells)."""
    cells, factor, weight = canvas.cells, canvas.factor[channel], canvas.weight[channel]
    lamp, sent = (cells, factor) if sender is None else (sender.cells, sender.factor[channel])
    light = lamp.total(np.square(sent)[None])[:, 0]
    received = cells.shared_out(factor * canvas.known, weight)
    matrix = model.between(received, lamp.shared_out(sent, light), channel)
    return matrix if sender is not None else np.float32(0.5) * (matrix + matrix.T)


def _predicted(canvas: Canvas, lit: NDArray[np.bool_], model: Transport) -> Float:
    """Return a model's pictures of patterns, as `CellPictures.radiance`."""
    parts = [lit[first : first + 64] for first in range(0, len(lit), 64)]
    return np.concatenate([canvas.reduced(relit(model, part)) for part in parts])


def _kept(cores: Float, weights: NDArray[np.float64], sent: Float) -> Residual:
    """Keep the cores without which a picture would change by more than a part of its norm."""
    change = np.zeros(cores.shape[1:])
    for entries, weight in zip(cores, weights, strict=True):
        energy = np.square(entries)
        both = energy * weight
        if not sent.size:
            both = np.triu(both) + np.triu(energy * weight[:, None], 1)
        change = np.maximum(change, both)
    rising = np.sort(change, axis=None)
    dropped = np.searchsorted(np.cumsum(rising), 5e-4**2, side="right")
    least = np.append(rising, np.inf)[dropped]
    pairs = np.stack(np.nonzero(change >= max(least, _TINY))).astype(np.int32)
    return Residual(pairs, np.ascontiguousarray(cores[:, pairs[0], pairs[1]]), sent)


class Posterior:
    """K of one channel given what a model leaves of pictures of cells, over F.

    Parameters
    ----------
    haar : Haar
        Of the camera's cells.
    light : ndarray of float32, shape (projector cells, P)
        Sums of the patterns times F.
    observed, variance : ndarray of float32, shape (cells, P)
        The variance is infinite where nothing is known.
    sender : tuple of Haar and ndarray, optional
        Of the projector's cells, and their `Sender.places`. Without one, K is symmetric.
    """

    def __init__(
        self,
        haar: Haar,
        light: Float,
        observed: Float,
        variance: Float,
        sender: tuple[Haar, Float] | None = None,
    ) -> None:
        self.haar, self.cells = haar, np.ascontiguousarray(light)
        self.symmetric = sender is None
        self.lamp = haar if sender is None else sender[0]
        self._places = None if sender is None else sender[1]
        self._known = np.isfinite(variance)
        self.observed = np.where(self._known, observed, 0)
        self._variance = np.where(self._known, variance, 0)
        certainty = np.divide(
            1, self._variance, where=self._known, out=np.zeros_like(self.observed)
        )
        self._noise = 1 / max(float(certainty.mean(dtype=np.float64)), _TINY)
        self.light = self.lamp.forward(self.cells)
        lit = max(float(np.square(self.cells, dtype=np.float64).mean()), _TINY)
        # variance of what cells send back directly: a part of that of what the model leaves
        self._direct = np.float32(0.02 * self.observed.var(dtype=np.float64) / lit)
        self._alike = [rows for group in haar.groups for rows in group.alike()]

    def left(self, matrix: Float, direct: Float) -> Float:
        """Return what K, and direct light, leave of the pictures (cells, P); 0 if unknown."""
        predicted = matrix @ self.cells
        if self.symmetric:
            predicted += direct[:, None] * self.cells
        residual: Float = np.where(self._known, self.observed - predicted, 0)
        return residual

    def _pairs(self) -> Iterator[tuple[Group, Group]]:
        """Yield each pair of scales, once where K is symmetric."""
        for index, one in enumerate(self.haar.groups):
            for other in self.lamp.groups[index if self.symmetric else 0 :]:
                yield one, other

    def _distances(self, one: Group, other: Group) -> Float:
        """Distances of places in cells, whichever views they are in, (places, places)."""
        centres = other.centres()
        if self._places is not None:
            _, height, width = self.lamp.stack
            cell = np.minimum(centres.astype(np.int64), (height - 1, width - 1))
            views = np.repeat(np.arange(other.grid[0]), other.grid[1] * other.grid[2])
            centres = self._places[(views * height + cell[:, 0]) * width + cell[:, 1]]
        apart = one.centres()[:, None] - centres
        distance: Float = np.hypot(apart[..., 0], apart[..., 1])
        return distance

    def _spread(self, variance: Float, one: Group, other: Group, each: Float) -> None:
        """Write the variances of pairs of places for all orientations."""
        if one is other:
            each = np.float32(0.5) * (each + each.T)
        shape = (one.orientations, one.places, other.orientations, other.places)
        whole = np.broadcast_to(each[None, :, None], shape).reshape(
            one.orientations * one.places, other.orientations * other.places
        )
        variance[one.rows, other.rows] = whole
        if self.symmetric and one is not other:
            variance[other.rows, one.rows] = whole.T

    def guessed(self) -> Float:
        """Return variances of C before any fit, (size, size): falling with the distance's square.

        The unit of distance is half a cell.
        """
        changing = self.light - self.light.mean(axis=1, keepdims=True)
        unit = np.square(changing, dtype=np.float64).sum(axis=0).mean() / len(changing)
        energy = np.square(self.observed, dtype=np.float64).sum(axis=0).mean()
        variance = np.empty((self.haar.size, self.lamp.size), np.float32)
        for one, other in self._pairs():
            apart = 1 + np.square(self._distances(one, other) / 0.5)
            each = (one.side * other.side) ** 2 / apart
            self._spread(variance, one, other, each.astype(np.float32))
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
        if self.symmetric:
            before = 1 / self.prior
            certainty = np.maximum(certainty + certainty.T - before, before)
        energy = np.square(self.core) + 1 / certainty
        variance = np.empty_like(energy)
        for one, other in self._pairs():
            part = energy[one.rows, other.rows].reshape(
                one.orientations, one.places, other.orientations, other.places
            )
            pairs = part.mean(axis=(0, 2))
            grid = (*one.grid, *other.grid)
            smooth = uniform_filter(pairs.reshape(grid), size=(1, 3, 3, 1, 3, 3), mode="nearest")
            pairs = (pairs + smooth.reshape(pairs.shape)) / 2
            distances = self._distances(one, other)
            half_octave: NDArray[np.int64] = (2 * np.log2(1 + distances)).astype(int)
            count = np.maximum(np.bincount(half_octave.ravel()), 1)
            typical = np.bincount(half_octave.ravel(), pairs.ravel()) / count
            each = one.orientations * other.orientations
            drawn = (each * pairs + typical[half_octave]) / (each + 1)
            self._spread(variance, one, other, drawn.astype(np.float32))
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
        matrix = self.lamp.inverse(np.ascontiguousarray(half.T))
        return matrix if self.symmetric else np.ascontiguousarray(matrix.T)

    def _applied(self, dual: Float) -> Float:
        """Apply the covariance of the pictures; the solution that goes with it is left behind."""
        from rfpipe.methods.adaptive.kernels import symmetric_product

        core: Float = self.haar.forward(dual) @ self.light.T
        if self.symmetric:
            symmetric_product(core, self.prior)
        else:
            core *= self.prior
        self.core = core
        pictures = self.haar.inverse(core @ self.light)
        self.direct = np.zeros(len(dual), np.float32)
        if self.symmetric:
            self.direct = self._direct * np.einsum("cm,cm->c", dual, self.cells)
            pictures += self.direct[:, None] * self.cells
        pictures += self._times * self._variance * dual
        pictures *= self._known
        return pictures

    def _preconditioned(self, rest: Float) -> Float:
        coefficients = self.haar.forward(rest)
        for inverse, rows in zip(self._inverses, self._alike, strict=True):
            coefficients[rows] = coefficients[rows] @ inverse
        return self.haar.inverse(coefficients) * self._known
