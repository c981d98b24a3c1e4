"""Errors of fits to photographs of Gray code: places, their confidence, and left-out pictures.

The photographs lie in a folder ``pictures``, in OpenCV's order with complements. Beside it,
``truth.npz`` has the decoded ``column`` and ``row`` of each camera pixel in whole rays, and whether
it is ``lit``; a place's truth is the middle of its ray, the index plus 1/2.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rfpipe
from benchmarks.photographs.runs import run_fit
from rfpipe.array_types import Bools, Double, Float
from rfpipe.fitting import Series, read_series
from rfpipe.fitting.footprints import solve_footprints
from rfpipe.fitting.held_out import dependent_groups, mean_error, mean_picture
from rfpipe.fitting.least_squares import solve_least_squares
from rfpipe.fitting.noise import with_estimated_noise
from rfpipe.transport.correspondence import Correspondence

CODE = "gray:100x100"
"""Code that the photographs show."""

CONFIDENCE = (0, 0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 1)
"""Limits of the ranges of confidence in which reliability is measured."""


# Range of the true places within a square of pixels, in rays, up to which the square is judged.
_VARIES = 1.5
# Camera pixels that are decoded together.
_CHUNK = 1024
# Camera rays of least squares, as many as `rfpipe fit` takes for its error.
_RAYS = 2048


@dataclass(frozen=True)
class Truth:
    """True places of squares of camera pixels.

    Attributes
    ----------
    places : ndarray of float64, shape (h, w, 2)
        Mean row and column in the projector's image, in rays.
    judged : ndarray of bool, shape (h, w)
        Squares whose pixels are all lit and whose true places vary by less than 1.5 rays.
    lit : ndarray of bool, shape (h, w)
        Squares with at least one lit pixel.
    """

    places: Double
    judged: Bools
    lit: Bools

    @classmethod
    def read(cls, file: Path, side: int) -> Truth:
        """Average ``truth.npz`` over squares of `side` x `side` pixels, which have to fit in."""
        with np.load(file) as arrays:
            rows, columns, lit = (_squares(arrays[name], side) for name in ("row", "column", "lit"))
        places = np.stack([rows, columns], axis=-1).astype(np.float64) + 0.5
        lit = lit.astype(np.bool_)
        judged = lit.all(axis=-1) & (np.ptp(places, axis=2) < _VARIES).all(axis=-1)
        return cls(places.mean(axis=2), np.asarray(judged), np.asarray(lit.any(axis=-1)))


def place_rows(folder: Path, sides: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Yield the errors of places for each camera bin, with the usage of ``rfpipe fit``.

    Yields
    ------
    dict
        ``camera_bin``; ``median``, ``nine_tenths`` (rays) and ``beyond_2`` (percent) of the
        distances between places in the mask and the truth; ``judged``, the squares that are
        compared; ``in_mask`` (percent of the squares with a truth); ``mask_outside_lit``, the
        squares in the mask without a lit pixel; ``within_1_of_A_B``, the share of places within
        one ray by confidence from A to B, with ``count_of_A_B`` squares; ``cpu_s``, ``peak_gib``.
    """
    for side in sides:
        with TemporaryDirectory() as scratch:
            output = Path(scratch) / "transport.zarr"
            run = run_fit(folder, output, "--patterns", CODE, "--camera-bin", f"{side}")
            row: dict[str, Any] = {"camera_bin": side}
            if run.failed:
                row["refused"] = " ".join(run.text.split())
            else:
                matches = rfpipe.open_transport(output).correspondence()
                truth = Truth.read(folder / "truth.npz", side)
                row |= _place_errors(matches, truth) | _reliability(matches, truth)
        yield row | {"cpu_s": run.seconds, "peak_gib": run.peak_gib}


def held_out_rows(folder: Path, side: int, pairs: Sequence[int] = ()) -> Iterator[dict[str, Any]]:
    """Yield errors of predicted pictures for pairs of a picture and its complement.

    Channels are summed, as `rfpipe fit` does for its error.

    Parameters
    ----------
    folder : Path
    side : int
        Camera bin.
    pairs : sequence of int
        Numbers of pairs from 0, in the code's order; all by default. A pair leaves together.

    Yields
    ------
    dict
        ``camera_bin``, ``pair``; errors in percent, the norm of the difference over the norm of
        the picture, less noise, mean of the pair: ``footprints``, ``decoded`` (see
        `decoded_pictures`), ``mean_picture`` (the mean picture times the pattern's light) and
        ``least_squares``.
    """
    series = with_estimated_noise(read_series(folder, patterns=CODE, camera_bin=side)).grey
    labels = dependent_groups(series.patterns)
    names = list(dict.fromkeys(labels[labels >= 0].tolist()))
    for pair in pairs or range(len(names)):
        is_held = labels == names[pair]
        training, held_out = (series.some(np.flatnonzero(part)) for part in (~is_held, is_held))
        shown = np.repeat(held_out.patterns, series.channels, axis=1)
        footprints = solve_footprints(training, [])
        predicted = {
            "footprints": footprints.forward(shown, range(series.channels)),
            "decoded": decoded_pictures(training, held_out.patterns[:, 0]),
            "mean_picture": mean_picture(training, held_out.patterns),
        }
        errors = {name: 100 * mean_error(images, held_out) for name, images in predicted.items()}
        errors["least_squares"] = 100 * _least_squares_error(training, held_out, shown)
        yield {"camera_bin": side, "pair": pair, **errors}


def decoded_pictures(training: Series, patterns: Float) -> Float:
    """Predict pictures by decoding Gray code, with direct light alone.

    The sign of a picture minus its complement is a bit. Each camera pixel's white light comes
    evenly from the rays whose bits differ least from its own.

    Parameters
    ----------
    training : Series
        White light, and pairs of pictures and complements.
    patterns : ndarray of float32, shape (K, N)

    Returns
    -------
    ndarray of float32, shape (K, C, M)
    """
    labels = dependent_groups(training.patterns)
    shown, light = training.patterns[:, 0], training.radiance.sum(axis=1)
    bits = [np.flatnonzero(labels == name) for name in np.unique(labels[labels >= 0])]
    rays = np.sign(np.stack([shown[a] - shown[b] for a, b in bits], axis=1))
    pixels = np.sign(np.stack([light[a] - light[b] for a, b in bits], axis=1))
    share = np.empty((len(patterns), len(pixels)), np.float32)
    for first in range(0, len(pixels), _CHUNK):
        agreement = pixels[first : first + _CHUNK] @ rays.T
        nearest = agreement == agreement.max(axis=1, keepdims=True)
        share[:, first : first + _CHUNK] = patterns @ nearest.T / nearest.sum(axis=1)
    white = training.radiance[labels < 0].mean(axis=0)
    return np.asarray(share[:, None] * white, np.float32)


def _least_squares_error(training: Series, held_out: Series, shown: Float) -> float:
    """Return the error of least squares on some camera rays: its transport is dense."""
    known = np.flatnonzero(training.known)
    chosen = known[np.unique(np.linspace(0, len(known) - 1, _RAYS).astype(np.int64))]
    transport = solve_least_squares(training.of_rays(chosen), [])
    predicted = transport.forward(shown, range(training.channels))
    return mean_error(predicted, held_out.of_rays(chosen))


def _place_errors(matches: Correspondence, truth: Truth) -> dict[str, float]:
    """Return distances of places from the truth, within the mask."""
    compared = matches.mask & truth.judged
    distance = np.linalg.norm(matches.places - truth.places, axis=-1)[compared]
    return {
        "median": float(np.median(distance)),
        "nine_tenths": float(np.quantile(distance, 0.9)),
        "beyond_2": 100 * float((distance > 2).mean()),
        "judged": int(compared.sum()),
        "in_mask": 100 * float(compared.sum() / truth.judged.sum()),
        "mask_outside_lit": int((matches.mask & ~truth.lit).sum()),
    }


def _reliability(matches: Correspondence, truth: Truth) -> dict[str, float]:
    """Return the share of places within one ray, and their number, by confidence."""
    distance = np.linalg.norm(matches.places - truth.places, axis=-1)[truth.judged]
    index = np.digitize(matches.confidence[truth.judged], CONFIDENCE[1:-1])
    row: dict[str, float] = {}
    for number, limits in enumerate(pairwise(CONFIDENCE)):
        name, within = "of_{:g}_{:g}".format(*limits), distance[index == number] <= 1
        row[f"within_1_{name}"] = float(within.mean()) if within.size else np.nan
        row[f"count_{name}"] = int(within.size)
    return row


def _squares(image: NDArray[Any], side: int) -> NDArray[Any]:
    """Return the pixels of each square, (h, w, side * side)."""
    rows, columns = (length // side for length in image.shape)
    split = image[: rows * side, : columns * side].reshape(rows, side, columns, side)
    return split.swapaxes(1, 2).reshape(rows, columns, side * side)
