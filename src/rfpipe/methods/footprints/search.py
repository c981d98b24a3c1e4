"""Footprints on all projector views: first ones, and better ones given indirect light.

Each view is searched by itself (`rfpipe.methods.footprints.geometry`), and weights are fitted to
what the search finds. Camera rays that take part in the fit of indirect light keep all candidates,
since their weights are marginalised there; other rays keep those with light.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from rfpipe.array_types import Float
from rfpipe.methods.footprints.candidates import Candidates, StoredCandidates, join_pixels
from rfpipe.methods.footprints.geometry import first_candidates, refined_footprints
from rfpipe.methods.footprints.indirect import IndirectLight
from rfpipe.methods.footprints.pictures import IndirectPictures
from rfpipe.methods.footprints.problem import PicturesByView, Problem
from rfpipe.methods.footprints.reciprocity import with_transposed
from rfpipe.methods.footprints.weights import fit_weights

FAINT = 0.005
"""Candidates below this fraction of the floodlit image are dropped between searches."""


def first_footprints(problem: Problem) -> StoredCandidates:
    """Search for footprints in the pictures alone, and fit their weights."""

    def search() -> Iterator[Candidates]:
        for pictures, boxes in zip(problem.grey, problem.boxes, strict=True):
            floodlit = pictures.floodlit
            # only the rays in the fit of indirect light need the candidates without light
            yield join_pixels(
                [
                    _without_faint(problem, part, floodlit, 0.0, pixels)
                    for pixels, part in first_candidates(pictures, problem.camera, boxes)
                ]
            )

    return StoredCandidates.of(search())


def better_footprints(
    problem: Problem, footprints: StoredCandidates, light: IndirectLight
) -> StoredCandidates:
    """Search for footprints in the pictures minus indirect light, and fit their weights."""
    grey, camera = problem.grey, problem.camera

    def search() -> Iterator[Candidates]:
        views = zip(grey, footprints, light.in_pictures(grey), problem.boxes, strict=True)
        for pictures, part, indirect, boxes in views:
            floodlit = pictures.floodlit
            # only the rays in the fit of indirect light need the faint candidates
            yield join_pixels(
                [
                    _without_faint(problem, fitted, floodlit, FAINT, pixels)
                    for pixels, fitted in refined_footprints(
                        pictures, part, indirect, camera, boxes
                    )
                ]
            )

    found = StoredCandidates.of(search())
    if not light.basis.mapping.shared_rays:
        return found
    return StoredCandidates.of(with_transposed(found))


def _without_faint(
    problem: Problem, candidates: Candidates, floodlit: Float, fraction: float, pixels: slice
) -> Candidates:
    """Drop weights of at most a fraction of the floodlit image, except of the rays in the fit.

    `candidates` belong to the camera pixels `pixels`, `floodlit` has all of them.
    """
    rays = problem.camera_rays
    if rays is None:
        return candidates
    exempt = rays[slice(*np.searchsorted(rays, [pixels.start, pixels.stop]))] - pixels.start
    return candidates.above(fraction, floodlit[pixels], exempt)


def fit_weights_of_views(
    pictures: PicturesByView,
    footprints: Iterable[Candidates],
    indirect: Iterable[IndirectPictures],
) -> StoredCandidates:
    """Fit the weights on each projector view to its pictures minus indirect light."""
    views = zip(footprints, pictures, indirect, strict=True)
    return StoredCandidates.of(fit_weights(part, view, in_view) for part, view, in_view in views)
