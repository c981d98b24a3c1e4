"""Search for footprints: the projector pixels that each camera pixel sees.

The search needs neither calibration nor structured light. At first a matched filter finds for each
camera pixel the box of the projector's image whose patterns its radiance resembles most
(`first_candidates`). Once indirect light is estimated, the candidates are (`refined_footprints`)

1. projector pixels whose weight exceeds 1 % of the floodlit image, and those that at least two of
   the eight neighbouring camera pixels see; each with its eight neighbours;
2. for camera pixels where these leave a residual that a box explains well, that box, such as a
   reflection.

Two places of the projector may have the same light in all patterns: with 24 patterns, for one pixel
in a hundred at 96 x 96. Then the place that neighbouring camera pixels also see is preferred, by a
larger prior variance: the prior standard deviation of a weight x is the larger of ``support x`` and
``(0.05 + 0.2 support) F``, with the floodlit radiance F. The *support*, 0 to 1, is the fraction of
the camera pixel's neighbours that see the candidate or a pixel near it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from rfpipe.array_types import TINY, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import Candidates, unique_keys
from rfpipe.methods.footprints.matching import (
    Boxes,
    MatchedFilter,
    coarse_light,
    matched_filter,
    pixels_in_boxes,
)
from rfpipe.methods.footprints.pictures import IndirectPictures, ViewArrays, ViewPictures
from rfpipe.methods.footprints.weights import (
    MODEL_ERROR,
    fit_weights_of_part,
    non_negative_weights,
)

# Least reduction of chi-square, the squared residual in squared standard deviations, by a new box,
# and its least share of chi-square.
_LEAST_CHI_SQUARE_DROP, _LEAST_DROP_SHARE = 25.0, 0.25
# Weights above this fraction of the floodlit image are certain enough to guide the search.
_STRONG = 0.01
# Standard deviations relative to the floodlit image in the first fit: weights, indirect light.
_FIRST_WEIGHT, _FIRST_INDIRECT = 1 / 4, 0.2

_NEIGHBOURS = [step for step in np.ndindex(3, 3) if step != (1, 1)]


def first_candidates(
    pictures: ViewPictures, camera: RayDomain, boxes: Boxes
) -> Iterator[tuple[slice, Candidates]]:
    """Find footprints from the pictures alone.

    Each lit camera pixel has the projector pixels of its best box as candidates. Their weights have
    a prior standard deviation of 25 % of the floodlit image.

    Yields
    ------
    pixels : slice
        A range of camera pixels.
    candidates : Candidates
        Theirs.
    """
    lit, size = np.flatnonzero(pictures.lit_pixels), boxes.projector.size
    box, correlation = matched_filter(boxes, pictures).match_image(pictures, camera)
    lit, box = lit[correlation > 0], box[correlation > 0]
    for first, last in pictures.ranges():
        part = pictures.at(slice(first, last))
        begin, end = np.searchsorted(lit, [first, last])
        keys = pixels_in_boxes(boxes, lit[begin:end] - first, box[begin:end])
        variance = np.square(_FIRST_WEIGHT * part.floodlit[keys // size]).astype(np.float32)
        candidates = Candidates(last - first, size, keys, variance, np.zeros_like(variance))
        yield slice(first, last), _fit_first_weights(candidates, part, boxes.projector)


def _fit_first_weights(
    candidates: Candidates, pictures: ViewPictures, projector: RayDomain
) -> Candidates:
    """Fit weights with smooth indirect light as noise.

    The covariance of a pixel's pictures is ``noise I + (0.2 F)^2 E'^T E' / coarse_cells``, where
    E', (coarse_cells, P), is the mean of each pattern over coarse cells (``E + 1/2``, see
    `coarse_light`), and noise the pixel's variance, radiance squared. The covariance becomes
    diagonal when pictures and patterns are multiplied by the eigenvectors of ``E'^T E'``.
    """
    floodlit, known = pictures.floodlit, pictures.known[:, None]
    cell_means = coarse_light(projector, pictures.patterns) + 0.5
    power, rotation = np.linalg.eigh(cell_means.T @ cell_means / len(cell_means))
    smooth = np.square(_FIRST_INDIRECT * floodlit)[:, None] * np.maximum(power, 0)
    inverse_variance = np.maximum(pictures.inverse_variance(MODEL_ERROR), TINY)
    noise = np.where(known, 1 / inverse_variance, 1).mean(axis=1, keepdims=True)
    return non_negative_weights(
        candidates,
        floodlit,
        (pictures.patterns @ rotation).astype(np.float32),
        (pictures.radiance @ rotation).astype(np.float32),
        np.where(known, 1 / (noise + smooth), 0).astype(np.float32),
    )


def refined_footprints(
    pictures: ViewPictures,
    footprints: Candidates,
    indirect: IndirectPictures,
    camera: RayDomain,
    boxes: Boxes,
) -> Iterator[tuple[slice, Candidates]]:
    """Search for footprints near earlier ones, near those of neighbours, and in the residual.

    The residual is what the weights of the candidates near earlier ones and near neighbours leave.
    Only camera pixels with a box that explains it are fitted again.

    Parameters
    ----------
    pictures : ViewPictures
    footprints : Candidates
        Earlier ones with their weights.
    indirect : IndirectPictures
        Indirect light in the pictures, radiance.
    camera : RayDomain
    boxes : Boxes

    Yields
    ------
    pixels : slice
        A range of camera pixels.
    footprints : Candidates
        Theirs, with fitted weights and the prior variances of the next fit.
    """
    strong = footprints.above(_STRONG, pictures.floodlit)
    brightest, matched = _brightest(strong, camera), matched_filter(boxes, pictures)
    for first, last in pictures.ranges():
        search = _Search(
            pictures.at(slice(first, last)),
            indirect[first:last],
            strong.between(first, last),
            _neighbour_places(brightest, camera, first, last),
        )
        fitted = _fit_near(search, boxes, strong.keys[:0])
        limit = boxes.most_series * (last - first) // camera.size
        pixels, keys = _boxes_of_residual(search, fitted, matched, limit)
        with_boxes = _fit_near(search.at(pixels), boxes, keys)
        yield slice(first, last), fitted.with_pixels(pixels, with_boxes)


class _Search(NamedTuple):
    """Inputs of the search for the footprints of m camera pixels.

    Attributes
    ----------
    pictures : ViewArrays
    indirect : ndarray of float32, shape (m, P)
        Indirect light in the pictures, radiance.
    strong : Candidates
        Earlier footprints above 1 % of the floodlit image.
    neighbour_places : ndarray of int64, shape (8, m)
        Brightest candidate of each neighbouring camera pixel, -1 for none.
    """

    pictures: ViewArrays
    indirect: Float
    strong: Candidates
    neighbour_places: Index

    def at(self, pixels: Index) -> _Search:
        """Select camera pixels by their numbers, ascending."""
        return _Search(
            self.pictures.at(pixels),
            self.indirect[pixels],
            self.strong.at(pixels),
            self.neighbour_places[:, pixels],
        )


def _fit_near(search: _Search, boxes: Boxes, keys: Index) -> Candidates:
    """Fit the weights of candidates near earlier ones, near neighbours, and of given keys."""
    candidates = _collected(search, boxes, keys)
    return fit_weights_of_part(candidates, search.pictures, search.indirect)


def _collected(search: _Search, boxes: Boxes, further: Index) -> Candidates:
    """Collect candidates with prior variances; new ones have weight 0.

    `further` are keys of candidates from the residual.
    """
    strong, neighbour_places = search.strong, search.neighbour_places
    floodlit = search.pictures.floodlit
    size, is_place = strong.projector_size, neighbour_places >= 0
    suggested = unique_keys((np.arange(len(floodlit)) * size + neighbour_places)[is_place])
    support = _neighbour_support(suggested, neighbour_places, boxes)
    confirmed = suggested[support > 1 / len(_NEIGHBOURS)]
    nearby = _with_neighbours(np.concatenate([strong.keys, confirmed]), boxes.projector)
    keys = unique_keys(np.concatenate([nearby, further]))
    weights = np.zeros(len(keys), np.float32)
    weights[np.searchsorted(keys, strong.keys)] = strong.weights
    support = _neighbour_support(keys, neighbour_places, boxes)
    least = (0.05 + 0.2 * support) * floodlit[keys // size]
    deviation = np.maximum(weights * support, least)
    variance = np.square(deviation).astype(np.float32)
    return Candidates(len(floodlit), size, keys, variance, weights)


def _boxes_of_residual(
    search: _Search, footprints: Candidates, matched: MatchedFilter, limit: int
) -> tuple[Index, Index]:
    """Find boxes that explain residuals of camera pixels.

    A box is accepted if its best weight reduces the pixel's chi-square by more than 25, and by more
    than 25 %. Pixels whose chi-square is above 25 and P / 2 are compared with boxes. Noise alone
    gives about P, so that this skips only pixels where the model fits better than noise. If there
    are more than `limit` pixels, only the ones of largest chi-square are compared.

    Returns
    -------
    pixels : ndarray of int64, shape (m,)
        Numbers of the camera pixels with a box, ascending.
    keys : ndarray of int64
        Candidates in and around the boxes: ``i N + j`` for pixel number i of `pixels`.
    """
    pictures = search.pictures
    inverse_variance = pictures.inverse_variance(MODEL_ERROR)
    residual = pictures.radiance - search.indirect - footprints.matrix() @ pictures.patterns
    chi_square: Float = np.einsum("iq,iq,iq->i", inverse_variance, residual, residual)
    may_hide_light = chi_square > max(_LEAST_CHI_SQUARE_DROP, residual.shape[1] / 2)
    pixel = np.flatnonzero(pictures.lit_pixels & may_hide_light)
    if len(pixel) > limit:
        worst = np.argsort(-chi_square[pixel], kind="stable")[:limit]
        pixel = np.sort(pixel[worst])
    residual, weight = residual[pixel], inverse_variance[pixel]
    box, correlation = matched.match(residual / pictures.floodlit[pixel, None])
    response = matched.boxes.responses(box, pictures.patterns)
    # reduction of chi-square by the box with its best weight
    drop = np.square(np.einsum("iq,iq,iq->i", weight, residual, response))
    drop /= np.maximum(np.einsum("iq,iq,iq->i", weight, response, response), TINY)
    explains = (correlation > 0) & (drop > _LEAST_CHI_SQUARE_DROP)
    explains &= drop > _LEAST_DROP_SHARE * chi_square[pixel]
    accepted = np.flatnonzero(explains)
    return pixel[accepted], pixels_in_boxes(matched.boxes, np.arange(len(accepted)), box[accepted])


def _brightest(strong: Candidates, camera: RayDomain) -> Index:
    """Find the brightest candidate of each camera pixel, -1 for none.

    Returns images (views, H + 2, W + 2), with a margin of -1 around each view.
    """
    order = np.argsort(strong.weights, kind="stable")
    brightest = np.full(camera.size, -1)
    # of repeated indices the last assignment stays
    brightest[strong.camera_pixels[order]] = strong.keys[order] % strong.projector_size
    image = brightest.reshape(camera.stack_shape)
    return np.pad(image, ((0, 0), (1, 1), (1, 1)), constant_values=-1)


def _neighbour_places(brightest: Index, camera: RayDomain, first: int, last: int) -> Index:
    """Select the places of the eight neighbours of the camera pixels ``first:last``.

    `brightest` are images of `_brightest`. Returns int64 (8, pixels), -1 for none.
    """
    view, row, column = np.unravel_index(np.arange(first, last), camera.stack_shape)
    return np.stack([brightest[view, row + down, column + right] for down, right in _NEIGHBOURS])


def _neighbour_support(keys: Index, neighbour_places: Index, boxes: Boxes) -> Float:
    """Compute the fraction of a camera pixel's neighbours that see a candidate or a pixel near it.

    Near is at most the width of the smaller box along both axes. Returns float32 (K,), 0 to 1.
    """
    projector, reach = boxes.projector, boxes.widths[0]
    width = projector.image_shape[1]
    camera_pixel, projector_pixel = np.divmod(keys, projector.size)
    row, column = np.divmod(projector_pixel, width)
    count = np.zeros(len(keys), np.float32)
    for down, right in zip(*np.divmod(neighbour_places, width), strict=True):
        near = (down[camera_pixel] >= 0) & (abs(row - down[camera_pixel]) <= reach)
        count += near & (abs(column - right[camera_pixel]) <= reach)
    return count / np.float32(len(neighbour_places))


def _with_neighbours(keys: Index, projector: RayDomain) -> Index:
    """Add the eight neighbours in the projector's image to candidates; returns sorted keys."""
    height, width = projector.image_shape
    row, column = keys // width % height, keys % width
    parts = [keys[:0]]
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            row_fits = (row + down >= 0) & (row + down < height)
            fits = row_fits & (column + right >= 0) & (column + right < width)
            parts.append(keys[fits] + down * width + right)
    return unique_keys(np.concatenate(parts))
