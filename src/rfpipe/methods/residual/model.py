"""What a model of the light leaves of all pictures together, whoever asked for them.

The transport of a coaxial rig is ``T = M + F K F + diag(d)``: M is any model's, F the root of the
floodlit image, and K symmetric, of any sign, ``K = W^T C W`` with Haar wavelets W; of another rig
``T = M + F K G``, where G is the root of what the projector's rays send, and K isn't symmetric. The
entries of C are independent normal deviates whose variances are learned from the pictures. Light
isn't negative, which says more of K than many pictures do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float, LevelImages
from rfpipe.methods.images import Pictures, planar_batches, relight_white
from rfpipe.methods.residual.posterior import Posterior
from rfpipe.methods.states import joined
from rfpipe.steps import step, steps
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport, sparse_arrays
from rfpipe.transport.wavelet import Cells, WaveletTransport, cell_side

MOST_CELLS = 4096
"""Of so many cells, the covariance of all pairs takes 64 MiB."""

# How often variances are learned and light is made to be not negative, and iterations of each.
_LEARNED, _CLIPPED, _ITERATIONS = 2, 8, 8
# Of more pictures, those are fitted that the model predicts worst: time grows with their square,
# and so does memory, to 1.3 GB with as many cells as there may be.
_MOST_PICTURES = 512
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
            return WaveletTransport(cells.shape, cells.shape, channels, [], arrays)
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
    batches = np.split(pictures.lit, range(64, len(pictures.lit), 64))
    predicted = [canvas.reduced(relight_white(model, lit)) for lit in batches]
    residual = pictures.radiance - np.concatenate(predicted)
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
    order = sorted(range(channels), key=lambda index: index != brightest)
    shining = [channel for channel in order if canvas.brightest[channel] > 0]
    with steps("light between cells", _LEARNED + len(shining) * (1 + _CLIPPED)):
        for channel in shining:
            share = canvas.brightest[channel] / canvas.brightest[brightest]
            posterior = Posterior(
                cells.haar,
                lamp.total(lit * factor[channel]),
                residual[:, channel].T,
                variance[:, channel].T,
                None if sender is None else (lamp.haar, sender.places),
            )
            prior = _learned(posterior) if prior is None else prior
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


def _learned(posterior: Posterior) -> Float:
    """Return the variances that pictures tell of what cells exchange."""
    prior = posterior.guessed()
    for _ in range(_LEARNED):
        posterior.prepare(prior)
        posterior.solve(posterior.observed, _ITERATIONS)
        prior = posterior.relearned()
        step()
    return prior


def _not_negative(posterior: Posterior, prior: Float, model: Float) -> Float:
    """Return K, (cells, cells), that takes no more light from between cells than is there.

    Clip what is negative, find what the pictures then lack, and again. Noise would be fitted the
    more often the more often that is done; so pictures are taken for as much noisier.
    """
    posterior.prepare(prior)
    posterior.solve(posterior.observed, 2 * _ITERATIONS)
    matrix, direct = posterior.matrix(), posterior.direct
    step()
    posterior.prepare(prior, _CLIPPED)
    between = np.ones(matrix.shape, np.bool_)
    if posterior.symmetric:
        np.fill_diagonal(between, val=False)
    for _ in range(_CLIPPED):
        np.maximum(matrix, -model, out=matrix, where=between)
        posterior.solve(posterior.left(matrix, direct), _ITERATIONS)
        matrix += posterior.matrix()
        direct = direct + posterior.direct
        step()
    return matrix


def _between(canvas: Canvas, model: Transport, channel: int, sender: Sender | None) -> Float:
    """Return the light that a model has between cells, over F on both sides, (cells, cells)."""
    cells, factor, weight = canvas.cells, canvas.factor[channel], canvas.weight[channel]
    lamp, sent = (cells, factor) if sender is None else (sender.cells, sender.factor[channel])
    light = lamp.total(np.square(sent)[None])[:, 0]
    received = cells.shared_out(factor * canvas.known, weight)
    matrix = model.between(received, lamp.shared_out(sent, light), channel)
    return matrix if sender is not None else np.float32(0.5) * (matrix + matrix.T)


def _kept(cores: Float, weights: NDArray[np.float64], sent: Float) -> Residual:
    """Keep the cores without which a picture would change by more than a part of its norm."""
    change = np.zeros(cores.shape[1:], np.float32)
    for entries, weight in zip(cores, weights.astype(np.float32), strict=True):
        both = np.square(entries) * (weight if sent.size else weight + weight[:, None])
        np.maximum(change, both, out=change)
    if not sent.size:
        change[np.diag_indices(len(change))] /= 2
        change = np.triu(change)
    rising = np.sort(change, axis=None)
    dropped = np.searchsorted(np.cumsum(rising, dtype=np.float64), 5e-4**2, side="right")
    least = np.append(rising, np.inf)[dropped]
    pairs = np.stack(np.nonzero(change >= max(least, _TINY))).astype(np.int32)
    return Residual(pairs, np.ascontiguousarray(cores[:, pairs[0], pairs[1]]), sent)
