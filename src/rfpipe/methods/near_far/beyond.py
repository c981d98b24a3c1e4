"""What smooth light, or a hierarchy, leaves: found from all pictures, whoever asked for them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import LevelImages
from rfpipe.methods.images import planar_batches
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.residual.pictures import Canvas, CellPictures
from rfpipe.methods.states import joined
from rfpipe.transport.wavelet.cells import Cells, cell_side

__all__ = ["MOST_CELLS", "all_pictures", "canvas_of", "cells_of", "taken"]

# Of so many cells, the covariance of all pairs takes 64 MiB.
MOST_CELLS = 4096


def cells_of(shape: tuple[int, ...], most: int = MOST_CELLS) -> Cells:
    """Return the cells in which a ray domain is looked at, at most so many."""
    return Cells(shape, cell_side(shape, most))


def canvas_of(shape: tuple[int, ...], pictures: Pictures, most: int = MOST_CELLS) -> Canvas:
    """Return what the pictures of an acquisition share; a channel of noise alone is dark."""
    shining = [pictures.channel(index).shine() for index in range(pictures.channels)]
    floodlit = pictures.floodlit * np.reshape(shining, (-1, 1))
    return Canvas(cells_of(shape, most), floodlit, pictures.known)


def taken(canvas: Canvas, images: LevelImages, first: int = 0) -> CellPictures:
    """Read a level's images from one on, summed over cells."""
    channels, rays = canvas.factor.shape
    found = []
    for part, seen, spread in planar_batches(images, channels, rays):
        lit = images.schedule.batch(part.start, part.stop).reshape(-1, rays) > 0
        whole = canvas.taken(lit, np.moveaxis(seen, 0, 1), np.moveaxis(spread, 0, 1))
        later = slice(max(first - part.start, 0), None)
        found.append(CellPictures(whole.lit[later], whole.seen[later], whole.variance[later]))
    return joined(found, axis=0)


def all_pictures(canvas: Canvas, pictures: Pictures, others: CellPictures | None) -> CellPictures:
    """Return the floodlit picture, those of smooth light's rounds, and all others."""
    everything: NDArray[np.bool_] = np.ones((1, len(canvas.known)), np.bool_)
    floodlit = canvas.taken(everything, pictures.floodlit[None], pictures.floodlit_variance[None])
    probes = canvas.taken(pictures.lit, pictures.radiance, pictures.variance)
    return joined([floodlit, probes, *([] if others is None else [others])], axis=0)
