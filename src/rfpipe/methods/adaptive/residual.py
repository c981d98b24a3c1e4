"""What a model of the light leaves of all pictures together, whoever asked for them.

The transport is ``T = M + F K F + diag(d)``: M is any model's, F the root of the floodlit image,
and K symmetric, of any sign, ``K = W^T C W`` with Haar wavelets W. The entries of C are independent
normal deviates whose variances are learned from the pictures. Light isn't negative, which says more
of K than many pictures do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.adaptive.pictures import Pictures
from rfpipe.methods.adaptive.posterior import Posterior
from rfpipe.methods.base import Float, LevelImages
from rfpipe.methods.images import planar_batches
from rfpipe.methods.states import joined
from rfpipe.transport.base import Transport
from rfpipe.transport.wavelet import Cells, WaveletTransport, cell_side

MOST_CELLS = 4096
"""Of so many cells, the covariance of all pairs takes 64 MiB."""

# How often light is made to be not negative, and iterations of each solution.
_CLIPPED, _ITERATIONS = 8, 8
# Of more pictures, those are fitted that the model predicts worst: time grows with their square,
# and so does memory, to 1.3 GB with as many cells as there may be.
_MOST_PICTURES = 512
_TINY = float(np.finfo(np.float32).tiny)


def cells_of(shape: tuple[int, ...], most: int = MOST_CELLS) -> Cells:
    """Return the cells in which a ray domain is looked at, at most so many."""
    return Cells(shape, cell_side(shape, most))


@dataclass(frozen=True)
class CellPictures:
    """Pictures, summed over cells.

    Attributes
    ----------
    lit : ndarray of bool, shape (P, N)
        The patterns, in pixels.
    radiance, variance : ndarray of float32, shape (P, C, cells)
        See `Canvas.reduced`; the variance is infinite where a cell has no known pixel.
    """

    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float


class Canvas:
    """What all pictures of an acquisition share.

    Parameters
    ----------
    cells : Cells
    floodlit : ndarray of float32, shape (C, N)
    known : ndarray of bool, shape (N,)
        Pixels that the pictures show.
    """

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
        own = np.where(self.weight > 0, np.stack(spread, axis=1), np.float32(np.inf))
        return CellPictures(lit, self.reduced(radiance), own)

    def read(self, images: LevelImages, first: int = 0) -> CellPictures:
        """Read a level's images from one on, a few at a time, summed over cells."""
        channels, rays = self.factor.shape
        lit = images.schedule.batch(first, images.schedule.count).reshape(-1, rays) > 0
        found = [
            self.taken(lit[part], np.moveaxis(radiance, 0, 1), np.moveaxis(variance, 0, 1))
            for part, radiance, variance in planar_batches(images, channels, rays, first)
        ]
        return joined(found, axis=0)

    def _over(self, weight: Float, images: Float, factor: Float) -> Float:
        sums = self.cells.total(images * factor).T
        return np.divide(sums, weight, out=np.zeros(sums.shape, np.float32), where=weight > 0)


@dataclass(frozen=True)
class Residual:
    """What a model leaves, as `WaveletTransport` has it.

    Attributes
    ----------
    pairs : ndarray of int32, shape (2, pairs)
    cores : ndarray of float32, shape (C, pairs)
    """

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
    left = pictures.radiance - _predicted(canvas, pictures.lit, model)
    # a picture may be wrong by a part of the brightest light in any case
    expected = np.square(np.float32(5e-4) * canvas.brightest)
    variance = pictures.variance + expected[:, None]
    telling = _telling(left, variance)
    lit, observed = pictures.lit[telling], pictures.radiance[telling]
    left, variance = left[telling], variance[telling]
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
        posterior = Posterior(haar, light, left[:, channel].T, variance[:, channel].T)
        if prior is None:
            prior = posterior.guessed()
            for _ in range(2):
                posterior.prepare(prior)
                posterior.solve(posterior.observed, _ITERATIONS)
                prior = posterior.relearned()
        found = _not_negative(posterior, prior * share**2, _between(canvas, model, channel))
        half = haar.forward(found)
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
    found, direct = posterior.matrix(), posterior.direct
    posterior.prepare(prior, _CLIPPED)
    between = ~np.eye(len(found), dtype=np.bool_)
    for _ in range(_CLIPPED):
        np.maximum(found, -model, out=found, where=between)
        predicted = found @ posterior.cells + direct[:, None] * posterior.cells
        posterior.solve(posterior.left(predicted), _ITERATIONS)
        found += posterior.matrix()
        direct = direct + posterior.direct
    return found


def _between(canvas: Canvas, model: Transport, channel: int) -> Float:
    """Return the light that a model has between cells, over F on both sides, (cells, cells)."""
    cells, factor, weight = canvas.cells, canvas.factor[channel], canvas.weight[channel]
    light = cells.total(np.square(factor)[None])[:, 0]
    sent = cells.shared_out(factor, light)
    received = cells.shared_out(factor * canvas.known, weight)
    found = model.between(received, sent, channel)
    return np.float32(0.5) * (found + found.T)


def _predicted(canvas: Canvas, lit: NDArray[np.bool_], model: Transport) -> Float:
    """Return a model's pictures of patterns, as `CellPictures.radiance`."""
    channels, batch = range(len(canvas.factor)), 64
    found = np.empty((len(lit), len(canvas.factor), canvas.cells.count), np.float32)
    for first in range(0, len(lit), batch):
        some = lit[first : first + batch, None].astype(np.float32)
        images = model.forward(
            np.broadcast_to(some, (len(some), len(channels), some.shape[-1])), channels
        )
        found[first : first + batch] = canvas.reduced(images)
    return found


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
