"""Rows that a camera could not measure, known from the columns of the same rays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
from rfpipe.transport.base import Float, Transport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multilevel.pairs import PairSet, agree, fold
from rfpipe.transport.multilevel.transport import MultilevelTransport
from rfpipe.transport.sum import SumTransport

__all__ = ["fill_from_transpose"]

# Rays whose columns are read at a time, and random patterns that tell whether T is symmetric.
_BATCH, _TRIALS = 16, 4


def fill_from_transpose(transport: Transport, masked: NDArray[np.bool_]) -> Transport:
    """Take the empty rows of masked camera rays from their columns, since T = T^T.

    Light from ray i to a masked ray j is that from j to i, which another pixel has seen. What
    nobody has seen stays dark: a masked ray's own direct light ``T_jj``, and light between two of
    them. Rows that a method has filled already, because its model is symmetric, stay as they are.

    Parameters
    ----------
    transport : Transport
    masked : ndarray of bool, shape (*camera_shape)
        Camera rays that no image shows.

    Returns
    -------
    Transport
        The same where there is nothing to fill, or where the rows that are known show that the rig
        isn't coaxial.
    """
    if not masked.any() or transport.camera_shape != transport.projector_shape:
        return transport
    rays = np.flatnonzero(masked)
    channels = range(transport.channels)
    rows = [transport.adjoint(lit, channels).any(axis=(1, 2)) for lit in _impulses(transport, rays)]
    rays = rays[~np.concatenate(rows)]
    if not len(rays) or not _is_symmetric(transport, ~masked.ravel()):
        return transport
    # what pixels saw of a block's masked rays is spread by what these rays saw: nothing yet
    source = _spread_evenly(transport)
    columns = [source.forward(lit, channels) for lit in _impulses(source, rays)]
    together = np.moveaxis(np.concatenate(columns), 1, 0)
    seen = together.any(axis=(0, 2))
    if not seen.any():
        return transport
    rays, together = rays[seen], together[:, seen]
    if isinstance(transport, MultilevelTransport):
        return _with_pairs(transport, rays, together)
    return _with_terms(transport, rays, together)


def _impulses(transport: Transport, rays: NDArray[np.int64]) -> Iterator[Float]:
    """Yield planar impulses (k, C, N) at some rays, a few at a time."""
    size = int(np.prod(transport.camera_shape))
    for first in range(0, len(rays), _BATCH):
        some = rays[first : first + _BATCH]
        lit = np.zeros((len(some), transport.channels, size), np.float32)
        lit[np.arange(len(some)), :, some] = 1
        yield lit


def _spread_evenly(transport: Transport) -> Transport:
    """Return a transport whose responses are spread evenly over their blocks."""
    if not isinstance(transport, MultilevelTransport) or not transport.symmetric:
        return transport
    return transport.with_pairs(transport.pair_sets, transport.level_rows, symmetric=False)


def _with_pairs(
    transport: MultilevelTransport, rays: NDArray[np.int64], columns: Float
) -> MultilevelTransport:
    """Add rows (C, n, N) as pairs of a single projector ray and one of `rays`."""
    tree, last = transport.tree, transport.tree.n_levels - 1
    which, block = np.nonzero(columns[..., tree.order].any(axis=0))
    more = PairSet(
        last,
        block.astype(np.int32),
        rays[which].astype(np.int32),
        columns[:, which, tree.order[block]],
    )
    finest = [*(pairs for pairs in transport.pair_sets if pairs.level == last), more]
    pair_sets = [
        *(pairs for pairs in transport.pair_sets if pairs.level < last),
        fold(tree, last, finest, transport.channels, tree.domain.size),
    ]
    return transport.with_pairs(pair_sets, transport.level_rows, transport.symmetric)


def _with_terms(transport: Transport, rays: NDArray[np.int64], columns: Float) -> SumTransport:
    """Add rows (C, n, N) as a term for each of `rays`."""
    arrays = {
        "left": np.zeros_like(columns),
        "right": np.ascontiguousarray(columns),
        "strengths": np.ones(columns.shape[:2], np.float32),
    }
    arrays["left"][:, np.arange(len(rays)), rays] = 1
    domain = transport.camera_shape
    added = LowRankTransport(domain, domain, transport.channels, [], arrays)
    return SumTransport([transport, added], transport.level_rows)


def _is_symmetric(transport: Transport, known: NDArray[np.bool_]) -> bool:
    """Tell whether a transport is its own transpose, but for errors, between known rays."""
    size = (_TRIALS, transport.channels, len(known))
    signs = (2 * generator(0).integers(0, 2, size) - 1).astype(np.float32) * known
    channels = range(transport.channels)
    there = transport.forward(signs, channels)[..., known].astype(np.float64)
    back = transport.adjoint(signs, channels)[..., known].astype(np.float64)
    return agree(there, back)
