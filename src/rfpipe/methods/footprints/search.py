"""Footprints on all projector views: first ones, and better ones given indirect light.

Each view is searched by itself (`rfpipe.methods.footprints.geometry`), and weights are fitted to
what the search finds. Camera rays that take part in the fit of indirect light keep all candidates,
since their weights are marginalised there; other rays keep those with light.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from rfpipe.array_types import Float
from rfpipe.methods.footprints.candidates import (
    Candidates,
    join_pixels,
    join_views,
    split_views,
    with_weights_of_views,
)
from rfpipe.methods.footprints.geometry import first_candidates, refined_footprints
from rfpipe.methods.footprints.indirect import IndirectLight
from rfpipe.methods.footprints.pictures import IndirectPictures
from rfpipe.methods.footprints.problem import PicturesByView, Problem
from rfpipe.methods.footprints.reciprocity import with_transposed
from rfpipe.methods.footprints.weights import fit_weights

FAINT = 0.005
"""Candidates below this fraction of the floodlit image are dropped between searches."""


def first_footprints(problem: Problem) -> Candidates:
    """Search for footprints in the pictures alone, and fit their weights."""
    views = []
    for pictures, boxes in zip(problem.grey, problem.boxes, strict=True):
        floodlit = pictures.floodlit
        # only the rays in the fit of indirect light need the candidates without light
        parts = [
            _without_faint(problem, part, floodlit, 0.0, pixels)
            for pixels, part in first_candidates(pictures, problem.camera, boxes)
        ]
        views.append(join_pixels(parts))
    return join_views(views)


def better_footprints(problem: Problem, footprints: Candidates, light: IndirectLight) -> Candidates:
    """Search for footprints in the pictures minus indirect light, and fit their weights."""
    grey, searched = problem.grey, []
    views = zip(
        grey, split_views(footprints, len(grey)), light.in_pictures(grey), problem.boxes,
        strict=True,
    )  # fmt: skip
    for pictures, part, in_pictures, boxes in views:
        floodlit = pictures.floodlit
        # only the rays in the fit of indirect light need the faint candidates
        refined = [
            _without_faint(problem, fitted, floodlit, FAINT, pixels)
            for pixels, fitted in refined_footprints(
                pictures, part, in_pictures, problem.camera, boxes
            )
        ]
        searched.append(join_pixels(refined))
    footprints = join_views(searched)
    return with_transposed(footprints) if light.basis.mapping.shared_rays else footprints


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
    pictures: PicturesByView, footprints: Candidates, indirect: Iterable[IndirectPictures]
) -> Candidates:
    """Fit the weights on each projector view to its pictures minus indirect light."""
    views = zip(split_views(footprints, len(pictures)), pictures, indirect, strict=True)
    fitted = (fit_weights(part, view, in_view) for part, view, in_view in views)
    return with_weights_of_views(footprints, fitted, len(pictures))
