"""Rows that a camera could not measure, known from the columns of the same rays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
from rfpipe.transport.base import Float, Transport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.responses import Responses, agree, by_level, fold
from rfpipe.transport.sum import SumTransport

_TRIALS = 4  # random patterns that tell whether T is symmetric


def fill_from_transpose(transport: Transport, masked: NDArray[np.bool_]) -> Transport:
    """Take the empty rows of masked camera rays from their columns, since T = T^T.

    Light from ray i to a masked ray j is that from j to i, which another pixel has seen. What
    nobody has seen stays dark: a masked ray's own direct light ``T_jj``, and light between two of
    them. Rows that a method has filled already, because its model is symmetric, stay as they are.

    `masked` are the camera rays that no image shows, bool (*camera_shape). The transport stays the
    same where there is nothing to fill, or where known rows show that the rig isn't coaxial.
    """
    if not masked.any() or transport.camera_shape != transport.projector_shape:
        return transport
    rays, every = np.flatnonzero(masked), np.arange(masked.size)
    parts = transport.blocks(rays, every, by_rows=True)
    rays = rays[~np.concatenate([rows.any(axis=(0, 2)) for *_, rows in parts])]
    if not len(rays) or not looks_coaxial(transport, ~masked):
        return transport
    # what pixels saw of a block's masked rays is spread by what these rays saw: nothing yet
    source = transport.evenly() if isinstance(transport, MultilevelTransport) else transport
    parts = source.blocks(every, rays, by_rows=False)
    rows = np.concatenate([columns.swapaxes(1, 2) for *_, columns in parts], axis=1)
    lit = rows.any(axis=(0, 2))
    if not lit.any():
        return transport
    with_rows = _with_pairs if isinstance(transport, MultilevelTransport) else _with_terms
    return with_rows(transport, rays[lit], rows[:, lit])


def _with_pairs(transport: Any, rays: NDArray[np.int64], rows: Float) -> Transport:
    """Add rows (C, n, N) as pairs of a single projector ray and one of `rays`."""
    tree, last = transport.tree, transport.last_level
    which, block = np.nonzero(rows[..., tree.order].any(axis=0))
    pixel, values = rays[which].astype(np.int32), rows[:, which, tree.order[block]]
    more = Responses(last, block.astype(np.int32), pixel, values)
    finest = [*(pairs for pairs in transport.level_responses if pairs.level == last), more]
    level_responses = [pairs for pairs in transport.level_responses if pairs.level < last]
    level_responses.append(fold(tree, last, finest, transport.channels, tree.domain.size))
    filled: Transport = transport.with_content(transport.level_rows, by_level(level_responses))
    return filled


def _with_terms(transport: Transport, rays: NDArray[np.int64], rows: Float) -> SumTransport:
    """Add rows (C, n, N) as a term for each of `rays`."""
    arrays = {
        "left": np.zeros_like(rows),
        "right": np.ascontiguousarray(rows),
        "strengths": np.ones(rows.shape[:2], np.float32),
    }
    arrays["left"][:, np.arange(len(rays)), rays] = 1
    domain = transport.camera_shape
    added = LowRankTransport(domain, domain, transport.channels, [], arrays)
    return SumTransport([transport, added], transport.level_rows)


def looks_coaxial(transport: Transport, known: NDArray[np.bool_] | None = None) -> bool:
    """Tell whether a transport is its own transpose, but for errors, between known rays."""
    if transport.camera_shape != transport.projector_shape:
        return False
    rays = np.prod(transport.camera_shape)
    known = np.ones(rays, np.bool_) if known is None else known.ravel()
    size = (_TRIALS, transport.channels, rays)
    signs = (2 * generator(0).integers(0, 2, size) - 1).astype(np.float32) * known
    channels = range(transport.channels)
    there = transport.forward(signs, channels)[..., known].astype(np.float64)
    back = transport.adjoint(signs, channels)[..., known].astype(np.float64)
    return agree(there, back)
