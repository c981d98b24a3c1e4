"""What all pictures together say of the light that a model leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.methods.residual.fit import Evidence, Posterior
from rfpipe.methods.residual.pictures import Canvas, CellPictures
from rfpipe.transport.base import Transport
from rfpipe.transport.wavelet.transport import WaveletTransport

__all__ = ["Residual", "estimate"]

# What a picture may be wrong by in any case, of the brightest light.
_EXPECTED = 5e-4
# How often variances are learned, light made to be not negative, and iterations of each solution.
_LEARNED, _CLIPPED, _ITERATIONS = 2, 8, 8
# Of a picture's norm, what may be lost with the cores that are not kept.
_DROPPED = 5e-4
_BATCH = 64
# Of more pictures, those are fitted that the model predicts worst: time grows with their square,
# and so does memory, to 1.3 GB with as many cells as there may be.
_MOST_PICTURES = 512
_TINY = float(np.finfo(np.float32).tiny)


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


def estimate(canvas: Canvas, pictures: CellPictures, model: Transport) -> Residual:
    """Find what is most probable given all pictures.

    Parameters
    ----------
    canvas : Canvas
    pictures : CellPictures
        The floodlit one first.
    model : Transport
        What is known already; need not be good.
    """
    channels, haar = len(canvas.factor), canvas.cells.haar
    left = pictures.seen - _predicted(canvas, pictures.lit, model)
    # what a picture may be wrong by in any case is added to what it is
    expected = np.square(np.float32(_EXPECTED) * canvas.brightest)
    variance = pictures.variance + expected[:, None]
    telling = _telling(left, variance)
    lit, seen = pictures.lit[telling], pictures.seen[telling]
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
        posterior = Posterior(haar, Evidence(light, left[:, channel].T, variance[:, channel].T))
        if prior is None:
            prior = _learned(posterior)
        found = _not_negative(posterior, prior * share**2, _between(canvas, model, channel))
        half = haar.forward(found)
        cores[channel] = haar.forward(np.ascontiguousarray(half.T))
        energy = np.square(seen[:, channel], dtype=np.float64).sum(axis=1).mean()
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


def _learned(posterior: Posterior) -> Float:
    """Return the variances that the pictures suggest."""
    prior = posterior.guessed()
    for _ in range(_LEARNED):
        posterior.prepare(prior)
        posterior.solve(posterior.seen, _ITERATIONS)
        prior = posterior.relearned()
    return prior


def _not_negative(posterior: Posterior, prior: Float, model: Float) -> Float:
    """Return K, (cells, cells), that takes no more light from between cells than is there.

    Clip what is negative, find what the pictures then lack, and again. Noise would be fitted the
    more often the more often that is done; so pictures are taken for as much noisier.
    """
    posterior.prepare(prior)
    posterior.solve(posterior.seen, 2 * _ITERATIONS)
    found, direct = posterior.matrix(), posterior.direct
    posterior.prepare(prior, _CLIPPED)
    between = ~np.eye(len(found), dtype=np.bool_)
    for _ in range(_CLIPPED):
        np.maximum(found, -model, out=found, where=between)
        told = found @ posterior.cells + direct[:, None] * posterior.cells
        posterior.solve(posterior.left(told), _ITERATIONS)
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
    """Return a model's pictures of patterns, as `CellPictures.seen`."""
    channels = range(len(canvas.factor))
    found = np.empty((len(lit), len(canvas.factor), canvas.cells.count), np.float32)
    for first in range(0, len(lit), _BATCH):
        some = lit[first : first + _BATCH, None].astype(np.float32)
        images = model.forward(
            np.broadcast_to(some, (len(some), len(channels), some.shape[-1])), channels
        )
        found[first : first + _BATCH] = canvas.reduced(images)
    return found


def _kept(cores: Float, weights: NDArray[np.float64]) -> Residual:
    """Keep the cores without which a picture would change by more than it may."""
    first, second = np.triu_indices(cores.shape[1])
    both = weights[:, first] + np.where(first != second, weights[:, second], 0)
    entries = cores[:, first, second]
    change = (np.square(entries) * both).max(axis=0)
    rising = np.sort(change)
    dropped = np.searchsorted(np.cumsum(rising), _DROPPED**2, side="right")
    kept = np.flatnonzero(change >= np.append(rising, np.inf)[dropped])
    pairs = np.stack([first[kept], second[kept]]).astype(np.int32)
    return Residual(pairs, np.ascontiguousarray(entries[:, kept]))
