"""Looks at a rig: pictures of one pattern that are taken repeatedly, and the gain of each.

A *look* is the bracket of black B, of a pattern P, of its complement Q, or of white, P + Q. With a
reference R of each, the counts F of an exposure are fitted over the camera's pixels by ::

    F = R_B + x_P (R_P - R_B) + x_Q (R_Q - R_B) + a

======== ================= ========= ==========================================================
symbol   name              shape     meaning
======== ================= ========= ==========================================================
F        frames            (E, n)    counts of n camera pixels, unsaturated ones in the fit
R        references        (3, E, n) the same, of B, P and Q
x, a     solution          (3,)      of one exposure
g        gain              (E,)      ``x_P - x_Q`` of a look at P, ``x_Q - x_P`` at Q,
                                     ``(x_P + x_Q) / 2`` at white
r        residual          (E,)      RMS of what the fit leaves, relative to the light of P or Q
======== ================= ========= ==========================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.flicker import exposure_ratios
from rfpipe.units import SATURATION_FRACTION

Double = NDArray[np.float64]

BLACK, PATTERN, COMPLEMENT, WHITE = range(4)
"""Pictures of looks."""

MOST_PIXELS = 2**16
"""Photosites of a frame that are compared, at most."""

_GAIN = {PATTERN: (1, -1, 0), COMPLEMENT: (-1, 1, 0), WHITE: (0.5, 0.5, 0)}
"""Weights of the solution that make up the gain."""

_LEAST_PIXELS = 50
_ROUNDING = 0.5  # counts
_HEADROOM = 0.8  # counts of references over saturation: a brighter look does not saturate


@dataclass(frozen=True, eq=False)
class Look:
    """A bracket of a known picture.

    Attributes
    ----------
    picture : {BLACK, PATTERN, COMPLEMENT, WHITE}
    series : int
        Looks that are taken right after each other have the same number.
    seconds : float
        Time at which it was taken.
    frames : ndarray of float32, shape (E, n)
        Counts; see `thinned`.
    """

    picture: int
    series: int
    seconds: float
    frames: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class References:
    """Brackets that looks are compared with.

    Attributes
    ----------
    frames : ndarray of float64, shape (3, E, n)
        Of black, pattern and complement.
    noise : ndarray of float64, shape (E,)
        Residual that noise alone leaves; infinite where an exposure has no light to compare.
    exposures : tuple of float
        Seconds.
    saturated : float
        Counts from which on a photosite says no more.
    seconds : float
        Time at which they were taken.
    unit : str
        Unit of that time and of the looks'.
    """

    frames: Double
    noise: Double
    exposures: tuple[float, ...]
    saturated: float
    seconds: float
    unit: str = "s"

    @classmethod
    def of(cls, looks: Sequence[Look], sensor: CameraModel) -> References:
        """Return the references of a series in which each picture is shown twice in succession.

        The second look of two is of its picture even where frames are late by a bracket.
        """
        second_looks = looks[1::2]
        frames = np.stack(
            [
                np.mean([look.frames for look in second_looks if look.picture == picture], axis=0)
                for picture in (BLACK, PATTERN, COMPLEMENT)
            ]
        ).astype(np.float64)
        bare = cls(
            frames, np.zeros(frames.shape[1]), tuple(sensor.exposures), saturated_from(sensor),
            float(np.mean([look.seconds for look in second_looks])),
        )  # fmt: skip
        pairs = [pair for pair in zip(looks[::2], second_looks, strict=True) if pair[1].picture]
        return replace(bare, noise=_noise(bare, pairs))

    @property
    def light(self) -> Double:
        """Light of pattern and complement in counts, (2, E, n)."""
        return np.asarray(self.frames[1:] - self.frames[0])

    def light_of(self, picture: int) -> Double:
        """Return the light of a lit picture in counts, (E, n)."""
        light: Double = self.light.sum(axis=0) if picture == WHITE else self.light[picture - 1]
        return light

    @property
    def white_rate(self) -> float:
        """Counts a second of the projector's white picture, by the shortest exposure."""
        return float(self.light[:, 0].sum(axis=0).mean()) / self.exposures[0]

    @property
    def has_light(self) -> bool:
        """Whether the pattern is seen above the noise in any exposure."""
        return bool(np.isfinite(self.noise).any()) and self.white_rate > 0


class Fit(NamedTuple):
    """Fit of a lit look; NaN in exposures that cannot be fitted.

    Attributes
    ----------
    solution : ndarray of float64, shape (E, 3)
        x_P, x_Q and a.
    gain, gain_error, residual : ndarray of float64, shape (E,)
    room, room_error : ndarray of float64, shape (E,)
        Mean light of the room, beyond that of the references, in counts; not known at white.
    """

    solution: Double
    gain: Double
    gain_error: Double
    residual: Double
    room: Double
    room_error: Double


class Series(NamedTuple):
    """Light of K lit looks.

    Attributes
    ----------
    gain, error : ndarray of float64, shape (K, E)
        Relative to a reference, and its standard error; NaN where an exposure is unknown.
    ratio, ratio_error : ndarray of float64, shape (M, E - 1)
        Light in each exposure over that in the next shorter one, of these or of other lit
        pictures; see `rfpipe.rigs.flicker`.
    series, seconds : ndarray, shape (K,)
        Series and time of each look.
    """

    gain: Double
    error: Double
    ratio: Double
    ratio_error: Double
    series: NDArray[np.int64]
    seconds: Double


def saturated_from(sensor: CameraModel) -> float:
    """Return the counts from which on a photosite of a camera is saturated."""
    return SATURATION_FRACTION * sensor.white_level


def thinned(frames: NDArray[Any], most: int = MOST_PIXELS) -> NDArray[np.float32]:
    """Return at most `most` photosites of each frame of a bracket (E, ...), (E, n)."""
    flat = frames.reshape(len(frames), -1)
    step = -(-flat.shape[1] // most) | 1  # odd: photosites of every colour of a mosaic
    return np.asarray(flat[:, ::step], np.float32)


def gains_of(looks: Sequence[Look], references: References) -> Series:
    """Return the light of the lit looks, by their fits."""
    lit = [look for look in looks if look.picture != BLACK]
    fits = [fit_of(look, references) for look in lit]
    gain, error = (
        np.array([getattr(fit, name) for fit in fits]) for name in ("gain", "gain_error")
    )
    return series_of(lit, references, gain, error)


def series_of(looks: Sequence[Look], references: References, gain: Double, error: Double) -> Series:
    """Return the light of lit looks whose gains (K, E) are known."""
    ratio, ratio_error = ratios_of([look.frames for look in looks], references)
    return Series(
        gain, error, ratio, ratio_error,
        np.array([look.series for look in looks]), np.array([look.seconds for look in looks]),
    )  # fmt: skip


def ratios_of(
    brackets: Sequence[NDArray[np.float32]], references: References
) -> tuple[Double, Double]:
    """Return the `exposure_ratios` of brackets (E, n), (K, E - 1), and their errors."""
    known = references.frames[BLACK], references.exposures, references.saturated
    ratios = np.array([exposure_ratios(frames, *known) for frames in brackets])
    return ratios[:, 0], ratios[:, 1]


def fit_of(look: Look, references: References) -> Fit:
    """Fit each exposure of a lit look."""
    exposures = len(references.exposures)
    along = np.array(_GAIN[look.picture], np.float64)
    gain, error, residual, room, room_error = np.full((5, exposures), np.nan)
    solutions = np.full((exposures, 3), np.nan)
    for index in range(exposures):
        frame = look.frames[index].astype(np.float64)
        usable = np.logical_and(_usable(references, index), frame < references.saturated)
        shown = references.light_of(look.picture)[index, usable]
        is_known = usable.sum() >= _LEAST_PIXELS and np.isfinite(references.noise[index])
        if not is_known or shown.sum() <= 0:
            continue
        counts = frame[usable] - references.frames[BLACK, index, usable]
        solutions[index], rest, covariance = _regression(
            references, index, usable, counts, has_haze=look.picture != WHITE
        )
        gain[index] = along @ solutions[index]
        residual[index] = np.sqrt(np.square(rest).sum() / np.square(shown).sum())
        # noise of the references bends the fit by the square of the residual
        bias = references.noise[index] ** 2
        error[index] = np.hypot(np.sqrt(along @ covariance @ along), bias)
        if look.picture != WHITE:
            white = float(references.light[:, index, usable].sum(axis=0).mean())
            of_room = np.array([white * (along[0] < 0), white * (along[1] < 0), 1.0])
            room[index] = of_room @ solutions[index]
            room_error[index] = np.hypot(np.sqrt(of_room @ covariance @ of_room), bias * white)
    return Fit(solutions, gain, error, residual, room, room_error)


def _usable(references: References, exposure: int) -> NDArray[np.bool_]:
    """Test which pixels are far from saturation in an exposure of all references."""
    brightest = references.frames[:, exposure].max(axis=0)
    return np.asarray(brightest < _HEADROOM * references.saturated)


def _regression(
    references: References,
    exposure: int,
    usable: NDArray[np.bool_],
    counts: Double,
    *,
    has_haze: bool = True,
) -> tuple[Double, Double, Double]:
    """Return solution (3,), residuals and covariance (3, 3) of counts above black.

    Pixels have weights as of photon noise. The covariance is that of any noise: HC3 of MacKinnon
    and White, Journal of Econometrics 29 (1985). Without haze, `a` is 0: before an even surface
    haze is like white light.
    """
    light = references.light[:, exposure, usable]
    design = np.stack([*light, np.full(light.shape[1], float(has_haze))], axis=1)
    brightness = np.maximum(light.sum(axis=0), 0)
    weight = 1 / (brightness + 0.1 * brightness.mean() + 1)
    solve = np.linalg.pinv((design.T * weight) @ design) @ (design.T * weight)
    solution = solve @ counts
    rest = counts - design @ solution
    leverage = np.einsum("ij,ji->i", design, solve)
    spread = solve * (rest / np.maximum(1 - leverage, 1e-3))
    return solution, rest, spread @ spread.T


def _noise(references: References, pairs: Sequence[tuple[Look, Look]]) -> Double:
    """Return the median residual between two successive looks at one picture, (E,)."""
    noise = np.full(len(references.exposures), np.inf)
    for index in range(len(noise)):
        residuals = []
        for first, second in pairs:
            brighter = np.maximum(first.frames[index], second.frames[index])
            usable = np.logical_and(_usable(references, index), brighter < references.saturated)
            light = references.light_of(second.picture)[index, usable]
            if usable.sum() < _LEAST_PIXELS or light.sum() <= 0:
                continue
            change = np.subtract(second.frames[index], first.frames[index], dtype=np.float64)
            _, rest, _ = _regression(references, index, usable, change[usable])
            # rounding may hide all other noise in two looks, and not in a third one
            noise_of_counts = np.square(rest).mean() / 2 + _ROUNDING**2
            residuals.append(np.sqrt(noise_of_counts / np.square(light).mean()))
        # where noise hides the light itself, nothing can be compared
        if residuals and np.median(residuals) < 0.5:
            noise[index] = float(np.median(residuals))
    return noise


def common_gain(series: Series, limit: float) -> tuple[Double, Double]:
    """Return the gain (K,) that the exposures of each look have in common, and its error."""
    known = known_exposures(series, limit)
    # an error below 1e-4 is not believed
    weight = 1 / (np.square(series.error[:, known]) + 1e-8)
    total = weight.sum(axis=1)
    common: Double = (weight * series.gain[:, known]).sum(axis=1) / total
    return common, 1 / np.sqrt(total)


def known_exposures(series: Series, limit: float) -> NDArray[np.bool_]:
    """Test which exposures are known to a third of the limit; the best one, if none is."""
    worst = np.where(np.isfinite(series.gain), series.error, np.inf).max(axis=0)
    known: NDArray[np.bool_] = np.isfinite(worst) & (worst <= max(limit / 3, worst.min()))
    return known
