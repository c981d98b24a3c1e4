"""Footprints of light fields of coaxial pairs of cameras and projectors, where ``D = D^T``.

Each camera shares the rays of a projector, so that M = N. By reciprocity (thesis, eq. 2.10) camera
ray i receives from projector ray j as much as j would from i: both entries of D are estimates of
one weight. In a light field this matters, since each ray has footprints in every view. A rig with
one view isn't fitted by these functions, even if it is coaxial: near/far acquisition suits it, and
its direct light is a diagonal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from rfpipe.array_types import Float
from rfpipe.methods.footprints.candidates import (
    Candidates,
    split_views,
    with_weights_of_views,
)
from rfpipe.methods.footprints.pictures import IndirectPictures, ViewPictures
from rfpipe.methods.footprints.weights import fit_weights

# Largest difference between D and its transpose, relative to the norm of D. Footprints of rigs that
# aren't coaxial have nothing in common with their transpose.
_LARGEST_DIFFERENCE = 0.5
# Standard deviation of a weight from its transposed one: fractions of it and of the floodlit image.
_DIFFERENCE = (0.1, 0.003)


def is_symmetric(footprints: Candidates) -> bool:
    """Return True if D, (N, N), and its transpose differ by less than half of the norm of D."""
    completed, transposed = _with_transposed_weights(footprints)
    difference = np.linalg.norm(completed.weights - transposed)
    return bool(difference < _LARGEST_DIFFERENCE * np.linalg.norm(completed.weights))


def with_transposed(footprints: Candidates) -> Candidates:
    """Add a candidate with weight 0 wherever only the transposed one has light."""
    return _with_transposed_weights(footprints)[0]


def symmetrized(footprints: Candidates) -> Candidates:
    """Return ``(D + D^T) / 2``."""
    completed, transposed = _with_transposed_weights(footprints)
    return replace(completed, weights=((completed.weights + transposed) / 2).astype(np.float32))


def fit_reciprocal_weights(
    footprints: Candidates, pictures: Sequence[ViewPictures], indirect: Iterable[IndirectPictures]
) -> Candidates:
    """Fit the weights to the pictures minus indirect light, near the transposed weights.

    Parameters
    ----------
    footprints : Candidates
        On all views of the projector; M = N.
    pictures : sequence of ViewPictures
        One for each view.
    indirect : iterable of IndirectPictures
        Indirect light in the pictures of each view, radiance.
    """
    expected = _transposed(footprints)

    def fitted_views() -> Iterator[Candidates]:
        parts = split_views(expected, len(pictures))
        for view, part, light in zip(pictures, parts, indirect, strict=True):
            prior = part.with_variance(view.floodlit, *_DIFFERENCE)
            yield fit_weights(prior, view, light, prior.weights)

    return with_weights_of_views(expected, fitted_views(), len(pictures))


def _transposed(footprints: Candidates) -> Candidates:
    """Return ``D^T``, with the candidates of `with_transposed`."""
    completed, transposed = _with_transposed_weights(footprints)
    return replace(completed, weights=transposed)


def _with_transposed_weights(footprints: Candidates) -> tuple[Candidates, Float]:
    """Add the transposed candidates that have light, and return the transposed weights, too.

    The variance is the larger one of an entry and of its transposed one with light. M = N.
    """
    from rfpipe.methods.footprints.kernels import with_transposed_candidates

    keys, variance, weights, transposed = with_transposed_candidates(
        footprints.keys, footprints.variance, footprints.weights, footprints.projector_size
    )
    return replace(footprints, keys=keys, variance=variance, weights=weights), transposed
