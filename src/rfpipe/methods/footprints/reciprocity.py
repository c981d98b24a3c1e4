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
from rfpipe.methods.footprints.candidates import Candidates, StoredCandidates, join_pixels
from rfpipe.methods.footprints.pictures import IndirectPictures, ViewPictures
from rfpipe.methods.footprints.weights import fit_weights

# Largest difference between D and its transpose, relative to the norm of D. Footprints of rigs that
# aren't coaxial have nothing in common with their transpose.
_LARGEST_DIFFERENCE = 0.5
# Standard deviation of a weight from its transposed one: fractions of it and of the floodlit image.
_DIFFERENCE = (0.1, 0.003)


def is_symmetric(footprints: StoredCandidates) -> bool:
    """Return True if D, (N, N), and its transpose differ by less than half of the norm of D."""
    difference = light = 0.0
    for completed, transposed in _with_transposed_weights(footprints):
        difference += float(np.square(completed.weights - transposed).sum(dtype=np.float64))
        light += float(np.square(completed.weights).sum(dtype=np.float64))
    return difference < _LARGEST_DIFFERENCE**2 * light


def with_transposed(footprints: StoredCandidates) -> Iterator[Candidates]:
    """Add a candidate with weight 0 wherever only the transposed one has light, view by view."""
    return (completed for completed, _ in _with_transposed_weights(footprints))


def symmetrized(footprints: StoredCandidates) -> Iterator[Candidates]:
    """Compute ``(D + D^T) / 2``, view by view."""
    for completed, transposed in _with_transposed_weights(footprints):
        mean = ((completed.weights + transposed) / 2).astype(np.float32)
        yield replace(completed, weights=mean)


def fit_reciprocal_weights(
    footprints: StoredCandidates,
    pictures: Sequence[ViewPictures],
    indirect: Iterable[IndirectPictures],
) -> Iterator[Candidates]:
    """Fit the weights to the pictures minus indirect light, near the transposed weights.

    Parameters
    ----------
    footprints : StoredCandidates
        M = N.
    pictures : sequence of ViewPictures
        One for each view.
    indirect : iterable of IndirectPictures
        Indirect light in the pictures of each view, radiance.
    """
    views = zip(pictures, _with_transposed_weights(footprints), indirect, strict=True)
    for view, (completed, expected), light in views:
        prior = replace(completed, weights=expected).with_variance(view.floodlit, *_DIFFERENCE)
        yield fit_weights(prior, view, light, prior.weights)


def _with_transposed_weights(footprints: StoredCandidates) -> Iterator[tuple[Candidates, Float]]:
    """Add the transposed candidates that have light, and return the transposed weights, too.

    The variance is the larger one of an entry and of its transposed one with light. M = N. The
    columns of D on a projector view consist of a block for each camera view. The transposed block
    is among the columns on another projector view. Two blocks are in memory at a time.
    """
    from rfpipe.methods.footprints.kernels import CandidateEntries, with_transposed_candidates

    size, views = footprints.projector_size, range(len(footprints))
    ranges = [(view * size, (view + 1) * size) for view in views]
    for view in views:
        blocks, transposed = [], []
        for other in views:
            pair = (
                footprints.between(view, *ranges[other]),
                footprints.between(other, *ranges[view]),
            )
            direct, mirrored = (CandidateEntries(it.keys, it.variance, it.weights) for it in pair)
            merged = with_transposed_candidates(direct, mirrored, size)
            blocks.append(Candidates(size, size, merged.keys, merged.variance, merged.weights))
            transposed.append(merged.transposed)
        yield join_pixels(blocks), np.concatenate(transposed)
