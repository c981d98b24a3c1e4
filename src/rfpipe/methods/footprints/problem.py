"""Inputs of a fit of the footprint model: rig, pictures of the channels' sum, and limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rfpipe.array_types import Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.matching import Boxes, boxes_of
from rfpipe.methods.footprints.pictures import ViewPictures
from rfpipe.provenance import generator

PicturesByView = tuple[ViewPictures, ...]
"""Pictures of one channel, or of the channels' sum, for each projector view."""

# Seed, and default largest numbers, of the camera rays in the fit of indirect light: with several
# projector views, and with one.
_SEED, _LIGHT_FIELD_RAYS, _IMAGE_RAYS = 2006, 4096, 2**17


@dataclass(frozen=True)
class FitLimits:
    """Limits of the fits of indirect light.

    Attributes
    ----------
    camera_rays : int
        Largest number of camera rays; a random subset is used if there are more.
    core_parts : int
        Largest number of unknowns of S, two for each pair of functions.
    """

    camera_rays: int
    core_parts: int = 1_500_000


@dataclass(frozen=True)
class Problem:
    """Rig, pictures of the channels' sum, and limits of the fits.

    Attributes
    ----------
    camera, projector : RayDomain
    grey : tuple of ViewPictures
        One for each projector view.
    boxes : list of Boxes
        One for each projector view.
    camera_rays : ndarray of int64, optional
        Rays in the fits of indirect light, ascending; None for all.
    largest_part_count : int
        `FitLimits.core_parts`.
    """

    camera: RayDomain
    projector: RayDomain
    grey: PicturesByView
    boxes: list[Boxes]
    camera_rays: Index | None
    largest_part_count: int


def make_problem(
    camera: RayDomain, projector: RayDomain, grey: PicturesByView, limits: FitLimits | None
) -> Problem:
    """Choose the boxes of the search and the camera rays of a fit, see `fit.fit_model`."""
    view = RayDomain(projector.image_shape)
    boxes = []
    for pictures in grey:
        lit_count = max(1.0, float(pictures.lit_pixels.sum()) / camera.views)
        # projector pixels that a lit camera pixel spans along each axis, approximately
        pixels_across = float(np.sqrt(view.size / lit_count))
        boxes.append(boxes_of(view, pixels_across))
    limits = limits or FitLimits(_LIGHT_FIELD_RAYS if len(grey) > 1 else _IMAGE_RAYS)
    camera_rays = None
    if camera.size > limits.camera_rays:
        order = generator(_SEED, camera.size).permutation(camera.size)
        camera_rays = np.sort(order[: limits.camera_rays])
    return Problem(camera, projector, grey, boxes, camera_rays, limits.core_parts)
