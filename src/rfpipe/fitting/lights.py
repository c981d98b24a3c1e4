"""Checks of pictures under single lights in known directions: their error, and faulty lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.errors import InputError
from rfpipe.lights.interpolation import (
    KrigingModel,
    angles_between,
    covariance,
    interpolate,
    light_spacing,
    unit,
)

_SAMPLES = 1024
"""Values of each picture that are compared."""

_DEAD = 0.03
"""A picture with less than this share of the light of the median picture is dark."""

_SAME = 0.1
"""Pictures that differ by less than this share of the difference of neighbours are the same."""

_SAME_DIRECTION = 0.05
"""Lights nearer than this share of the lights' median spacing have the same direction."""

_MISPLACED = 0.5
"""A picture that fits another direction with less than this share of its error is misplaced."""

_MISPLACED_BY = 1.5
"""Angle, over the lights' spacing, of the smallest displacement that is reported."""

_MOST_PLACED = 256
"""More lights aren't compared with other directions: the time grows with their fourth power."""

_MODEL = KrigingModel("none", 2.0, 0.5, 0.1, "exponential")
"""Kriging model by which pictures are compared with those of other directions."""


@dataclass(frozen=True, eq=False)
class LightsCheck:
    """Result of `check_lights`.

    Attributes
    ----------
    error : float
        Expected error of pictures under lights from other directions among the lights: the norm of
        the difference over the picture's norm, mean over lights that are left out. NaN for fewer
        than four lights.
    errors : ndarray of float64, shape (L,)
        Of each light's picture, interpolated without it. NaN for black pictures, and for some of
        more than 128 lights.
    faults : tuple of str
        Sentences that name lights that are dead, doubled or misplaced; empty if all are right.
    """

    error: float
    errors: Double
    faults: tuple[str, ...]


def check_lights(
    pictures: NDArray[np.floating],
    directions: NDArray[np.floating],
    names: Sequence[str] = (),
    mask: NDArray[np.bool_] | None = None,
) -> LightsCheck:
    """Estimate the error between lights by leaving each out, and find faulty lights.

    Parameters
    ----------
    pictures : ndarray of float32, shape (L, C, M)
        Radiance under each light.
    directions : ndarray, shape (L, 3)
        Of the lights, of any length.
    names : sequence of L str
        Of the pictures, for messages; by default "picture 0" and so on.
    mask : ndarray of bool, shape (M,), optional
        Pixels of the object; all by default.

    Raises
    ------
    InputError
        If the shapes don't fit together, or no pixel is chosen.

    Notes
    -----
    Lamps of unequal power are no fault: pictures are compared up to a factor.
    """
    count, channels, pixels = pictures.shape
    names = list(names) or [f"picture {index}" for index in range(count)]
    if len(directions) != count or len(names) != count:
        raise InputError(
            f"{count} pictures, {len(directions)} directions and {len(names)} names; expected one "
            "each"
        )
    chosen = np.arange(pixels) if mask is None else np.flatnonzero(mask)
    if not len(chosen):
        raise InputError("the mask is empty: no pixel of the pictures is chosen")
    chosen = chosen[pictures[:, :, chosen].any(axis=(0, 1))]
    towards = unit(directions)
    if not len(chosen):
        return LightsCheck(np.nan, np.full(count, np.nan), ("all pictures are black",))
    samples = np.linspace(0, len(chosen) - 1, max(1, _SAMPLES // channels)).astype(int)
    y = np.asarray(pictures[:, :, chosen[np.unique(samples)]], np.float64).reshape(count, -1)
    dead = np.flatnonzero(_dead(pictures[:, :, chosen]))
    faults = [f"{names[i]} is dark: its lamp gave no light" for i in dead]
    alive = np.setdiff1d(np.arange(count), dead)
    pairs = _doubled(y[alive], towards[alive])
    faults += [f"{names[alive[i]]} and {names[alive[j]]} {what}" for i, j, what in pairs]
    single = np.setdiff1d(alive, [alive[j] for _, j, _ in pairs])
    for i, j, angle in _misplaced(y[single], towards[single]):
        faults.append(
            f"{names[single[i]]} fits the direction of {names[single[j]]} better than its own, "
            f"{angle:.0f} degrees away: is its light where the file says, are pictures exchanged?"
        )
    errors = np.full(count, np.nan)
    errors[alive] = interpolate(y[alive], towards[alive], most_folds=128).errors
    known = np.isfinite(errors)
    error = float(errors[known].mean()) if known.any() else np.nan
    return LightsCheck(error, errors, tuple(faults))


def _dead(pictures: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return whether each of the pictures (L, C, M) is dark beside the others."""
    norms = np.sqrt(np.square(pictures, dtype=np.float64).sum(axis=(1, 2)))
    return np.asarray(norms <= _DEAD * np.median(norms))


def _doubled(y: Double, directions: Double) -> list[tuple[int, int, str]]:
    """Return pairs of lights with one picture or direction, and the fault of each pair."""
    if len(y) < 3:
        return []
    angles = angles_between(directions, directions) + 10 * np.eye(len(y))
    norms = np.linalg.norm(y, axis=1)
    products = y @ y.T
    squares = norms[:, None] ** 2 + norms**2 - 2 * products
    difference = np.sqrt(np.maximum(squares, 0)) / np.maximum(norms[:, None], norms)
    nearest = angles.argmin(axis=1)
    typical = np.median(difference[np.arange(len(y)), nearest])
    spacing = np.median(angles.min(axis=1))
    pairs = []
    for i, j in zip(*np.triu_indices(len(y), 1), strict=True):
        if angles[i, j] < _SAME_DIRECTION * spacing:
            pairs.append((int(i), int(j), "have lights in the same direction"))
        elif difference[i, j] < _SAME * typical * min(1, angles[i, j] / spacing):
            pairs.append((int(i), int(j), "are the same picture, of two lights"))
    return pairs


def _misplaced(y: Double, directions: Double) -> list[tuple[int, int, float]]:
    """Return lights whose picture fits the direction of another light: both, and their angle.

    The light that fits worst is left out, and the others are compared again, so that the pictures
    of its neighbours aren't misjudged by it.
    """
    count = len(y)
    if not 6 <= count <= _MOST_PLACED:
        return []
    angles = angles_between(directions, directions)
    far = angles > _MISPLACED_BY * light_spacing(directions)
    trusted = np.ones(count, np.bool_)
    misplaced: list[tuple[int, int, float]] = []
    while trusted.sum() > count / 2:
        misfit = _misfits(y, angles, trusted)
        elsewhere = np.where(far, misfit, np.inf)
        ratio = elsewhere.min(axis=1) / np.diag(misfit)
        ratio[~trusted] = np.inf
        worst = int(ratio.argmin())
        if ratio[worst] >= _MISPLACED:
            break
        best = int(elsewhere[worst].argmin())
        misplaced.append((worst, best, float(np.degrees(angles[worst, best]))))
        trusted[worst] = False
    return misplaced


def _misfits(y: Double, angles: Double, trusted: NDArray[np.bool_]) -> Double:
    """Return the misfit of each light's picture (rows) at each light's direction (columns).

    A picture is predicted from all others that are trusted. The misfit is the sine of the angle
    between prediction and picture, so that the lamp's power doesn't matter.
    """
    count = len(y)
    system = covariance(angles, _MODEL) + _MODEL.nugget * np.eye(count)
    products = y @ y.T
    misfit = np.ones((count, count))
    for i in np.flatnonzero(trusted):
        training = np.flatnonzero(trusted & (np.arange(count) != i))
        inverse = np.linalg.inv(system[np.ix_(training, training)])
        weights = covariance(angles[:, training], _MODEL) @ inverse
        squares = ((weights @ products[np.ix_(training, training)]) * weights).sum(axis=1)
        along = weights @ products[training, i]
        cosine = along / np.sqrt(np.maximum(squares * products[i, i], 1e-30))
        misfit[i] = np.sqrt(np.maximum(1 - np.clip(cosine, 0, 1) ** 2, 1e-12))
    return misfit
