"""Rows of a symmetric transport that the camera could not measure, filled from its columns."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.provenance import generator
from rfpipe.transport.base import Transport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.responses import Responses, agree, by_level, fold
from rfpipe.transport.sum import SumTransport

_TRIALS = 4  # random patterns of the test for symmetry


def fill_from_transpose(transport: Transport, masked: NDArray[np.bool_]) -> Transport:
    """Fill the empty rows of masked camera rays from their columns, by ``T = T^T``.

    ``T_ji`` of a masked ray j is ``T_ij``, which pixel i has measured. Direct light ``T_jj`` and
    light between two masked rays remain 0. Rows that are not empty, since the method's model is
    symmetric, are not changed.

    Parameters
    ----------
    transport : Transport
    masked : ndarray of bool, shape (*camera_shape)
        Camera rays that no image shows.

    Returns
    -------
    Transport
        The same one if there is nothing to fill, or if known rows show that the rig isn't coaxial.
    """
    if not masked.any() or transport.camera_shape != transport.projector_shape:
        return transport
    rays, all_rays = np.flatnonzero(masked), np.arange(masked.size)
    parts = transport.blocks(rays, all_rays, by_rows=True)
    rays = rays[~np.concatenate([rows.any(axis=(0, 2)) for *_, rows in parts])]
    if not len(rays) or not looks_coaxial(transport, ~masked):
        return transport
    # the shares of masked rays in their blocks would come from their own responses, which are empty
    source = transport.evenly() if isinstance(transport, MultilevelTransport) else transport
    parts = source.blocks(all_rays, rays, by_rows=False)
    rows = np.concatenate([columns.swapaxes(1, 2) for *_, columns in parts], axis=1)
    lit = rows.any(axis=(0, 2))
    if not lit.any():
        return transport
    with_rows = _with_responses if isinstance(transport, MultilevelTransport) else _with_terms
    return with_rows(transport, rays[lit], rows[:, lit])


def _with_responses(transport: Any, rays: NDArray[np.int64], rows: Float) -> Transport:
    """Add rows (C, n, N) as responses of `rays` to single projector rays."""
    tree, last = transport.tree, transport.last_level
    row, block = np.nonzero(rows[..., tree.order].any(axis=0))
    pixel, values = rays[row].astype(np.int32), rows[:, row, tree.order[block]]
    added = Responses(last, block.astype(np.int32), pixel, values)
    finest = [*(it for it in transport.level_responses if it.level == last), added]
    level_responses = [it for it in transport.level_responses if it.level < last]
    level_responses.append(fold(tree, last, finest, transport.channels, tree.domain.size))
    filled: Transport = transport.with_content(transport.level_rows, by_level(level_responses))
    return filled


def _with_terms(transport: Transport, rays: NDArray[np.int64], rows: Float) -> SumTransport:
    """Add rows (C, n, N) as one low-rank term for each of `rays`."""
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
    """Test whether a transport is symmetric, up to errors, between known rays."""
    if transport.camera_shape != transport.projector_shape:
        return False
    rays = np.prod(transport.camera_shape)
    known = np.ones(rays, np.bool_) if known is None else known.ravel()
    size = (_TRIALS, transport.channels, rays)
    signs = (2 * generator(0).integers(0, 2, size) - 1).astype(np.float32) * known
    channels = range(transport.channels)
    image = transport.forward(signs, channels)[..., known].astype(np.float64)
    dual = transport.adjoint(signs, channels)[..., known].astype(np.float64)
    return agree(image, dual)
