"""Check pictures: repeated pictures of a few patterns, which show changes of light and rig.

A check picture is the bracket of black B, of a pattern P, of its complement Q, or of white, P + Q.
With a reference R of each, the counts F of an exposure are fitted over the camera's pixels by ::

    F = R_B + x_P (R_P - R_B) + x_Q (R_Q - R_B) + a

======== ================= ========= ==========================================================
symbol   name              shape     meaning
======== ================= ========= ==========================================================
F        frames            (E, n)    counts of n camera pixels, unsaturated ones in the fit
R        references        (3, E, n) reference counts of B, P and Q
x, a     solution          (3,)      coefficients of one exposure
g        gain              (E,)      ``x_P - x_Q`` for a picture of P, ``x_Q - x_P`` for Q,
                                     ``(x_P + x_Q) / 2`` for white
r        residual          (E,)      RMS residual of the fit, relative to the light of P or Q
======== ================= ========= ==========================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.flicker import exposure_ratios
from rfpipe.units import SATURATION_FRACTION

BLACK, PATTERN, COMPLEMENT, WHITE = range(4)
"""Patterns of check pictures: all-off, a pattern, its complement, all-on."""

MOST_PIXELS = 2**16
"""Largest number of photosites of a frame that are compared."""

_GAIN = {PATTERN: (1, -1, 0), COMPLEMENT: (-1, 1, 0), WHITE: (0.5, 0.5, 0)}
"""Weights of the solution that make up the gain."""

_LEAST_PIXELS = 50
_ROUNDING = 0.5  # counts
_HEADROOM = 0.8  # counts of references over saturation: a brighter picture does not saturate


@dataclass(frozen=True, eq=False)
class CheckPicture:
    """A bracket of black, of the pattern, of its complement or of white.

    Attributes
    ----------
    kind : {BLACK, PATTERN, COMPLEMENT, WHITE}
        The pattern.
    series : int
        Number of the series; pictures of one series follow each other directly.
    seconds : float
        Time of capture.
    frames : ndarray of float32, shape (E, n)
        Counts; see `thinned`.
    """

    kind: int
    series: int
    seconds: float
    frames: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class References:
    """Brackets with which check pictures are compared.

    Attributes
    ----------
    frames : ndarray of float64, shape (3, E, n)
        Counts under black, pattern and complement.
    noise : ndarray of float64, shape (E,)
        Residual due to noise; infinite where an exposure has no light to compare.
    exposures : tuple of float
        Exposure times in seconds.
    saturated : float
        Least count of a saturated photosite.
    seconds : float
        Time of capture.
    unit : str
        Unit of `seconds`, here and in the check pictures.
    """

    frames: Double
    noise: Double
    exposures: tuple[float, ...]
    saturated: float
    seconds: float
    unit: str = "s"

    @classmethod
    def of(cls, pictures: Sequence[CheckPicture], sensor: CameraModel) -> References:
        """Average the references from a series that shows each pattern twice in succession.

        Only the second picture of two is used: it shows its pattern even where frames are late by
        one bracket.
        """
        repetitions = pictures[1::2]
        frames = np.stack(
            [
                np.mean([picture.frames for picture in repetitions if picture.kind == kind], axis=0)
                for kind in (BLACK, PATTERN, COMPLEMENT)
            ]
        ).astype(np.float64)
        bare = cls(
            frames, np.zeros(frames.shape[1]), tuple(sensor.exposures), saturated_from(sensor),
            float(np.mean([picture.seconds for picture in repetitions])),
        )  # fmt: skip
        pairs = [pair for pair in zip(pictures[::2], repetitions, strict=True) if pair[1].kind]
        return replace(bare, noise=_noise(bare, pairs))

    @property
    def light(self) -> Double:
        """Light of pattern and complement in counts, (2, E, n)."""
        return np.asarray(self.frames[1:] - self.frames[0])

    def light_of(self, kind: int) -> Double:
        """Return the light of a lit picture in counts, (E, n)."""
        light: Double = self.light.sum(axis=0) if kind == WHITE else self.light[kind - 1]
        return light

    @property
    def white_rate(self) -> float:
        """Counts per second of the projector's white picture, by the shortest exposure."""
        return float(self.light[:, 0].sum(axis=0).mean()) / self.exposures[0]

    @property
    def has_light(self) -> bool:
        """True if the pattern exceeds the noise in any exposure."""
        return bool(np.isfinite(self.noise).any()) and self.white_rate > 0


class CheckFit(NamedTuple):
    """Fit of a lit check picture; NaN in exposures that cannot be fitted.

    Attributes
    ----------
    solution : ndarray of float64, shape (E, 3)
        x_P, x_Q and a.
    gain, gain_error, residual : ndarray of float64, shape (E,)
    room, room_error : ndarray of float64, shape (E,)
        Mean increase of the room's light since the references, in counts; NaN for white pictures.
    """

    solution: Double
    gain: Double
    gain_error: Double
    residual: Double
    room: Double
    room_error: Double


class LightSeries(NamedTuple):
    """Brightness of K lit check pictures over time.

    Attributes
    ----------
    gain, error : ndarray of float64, shape (K, E)
        Light relative to the reference, and its standard error; NaN where an exposure is unknown.
    ratio, ratio_error : ndarray of float64, shape (M, E - 1)
        Light in each exposure over the light in the next shorter one, and its standard error, of
        these or of other lit pictures; see `rfpipe.rigs.flicker`.
    series, seconds : ndarray, shape (K,)
        Series and time of each picture.
    """

    gain: Double
    error: Double
    ratio: Double
    ratio_error: Double
    series: NDArray[np.int64]
    seconds: Double


def saturated_from(sensor: CameraModel) -> float:
    """Return the least count of a saturated photosite of a camera."""
    return SATURATION_FRACTION * sensor.white_level


def thinned(frames: NDArray[Any], limit: int = MOST_PIXELS) -> NDArray[np.float32]:
    """Sample at most `limit` photosites of each frame of a bracket (E, ...); shape (E, n)."""
    flat = frames.reshape(len(frames), -1)
    step = -(-flat.shape[1] // limit) | 1  # odd: photosites of every colour of a mosaic
    return np.asarray(flat[:, ::step], np.float32)


def measured_light(pictures: Sequence[CheckPicture], references: References) -> LightSeries:
    """Fit the lit pictures, and return their light."""
    lit = [picture for picture in pictures if picture.kind != BLACK]
    fits = [fit_picture(picture, references) for picture in lit]
    gain, error = (
        np.array([getattr(fit, name) for fit in fits]) for name in ("gain", "gain_error")
    )
    return light_series(lit, references, gain, error)


def light_series(
    pictures: Sequence[CheckPicture], references: References, gain: Double, error: Double
) -> LightSeries:
    """Combine known gains (K, E) of lit pictures with the ratios of their exposures."""
    ratio, ratio_error = ratios_of_brackets([picture.frames for picture in pictures], references)
    return LightSeries(
        gain, error, ratio, ratio_error,
        np.array([picture.series for picture in pictures]),
        np.array([picture.seconds for picture in pictures]),
    )  # fmt: skip


def ratios_of_brackets(
    brackets: Sequence[NDArray[np.float32]], references: References
) -> tuple[Double, Double]:
    """Compute the `exposure_ratios` of K brackets (E, n), and their errors, (K, E - 1) both."""
    known = references.frames[BLACK], references.exposures, references.saturated
    ratios = np.array([exposure_ratios(frames, *known) for frames in brackets])
    return ratios[:, 0], ratios[:, 1]


def fit_picture(picture: CheckPicture, references: References) -> CheckFit:
    """Fit each exposure of a lit picture."""
    exposures = len(references.exposures)
    along = np.array(_GAIN[picture.kind], np.float64)
    gain, error, residual, room, room_error = np.full((5, exposures), np.nan)
    solutions = np.full((exposures, 3), np.nan)
    for index in range(exposures):
        frame = picture.frames[index].astype(np.float64)
        usable = np.logical_and(_usable(references, index), frame < references.saturated)
        shown = references.light_of(picture.kind)[index, usable]
        is_known = usable.sum() >= _LEAST_PIXELS and np.isfinite(references.noise[index])
        if not is_known or shown.sum() <= 0:
            continue
        counts = frame[usable] - references.frames[BLACK, index, usable]
        solutions[index], residuals, covariance = _regression(
            references, index, usable, counts, has_haze=picture.kind != WHITE
        )
        gain[index] = along @ solutions[index]
        residual[index] = np.sqrt(np.square(residuals).sum() / np.square(shown).sum())
        # noise of the references bends the fit by the square of the residual
        bias = references.noise[index] ** 2
        error[index] = np.hypot(np.sqrt(along @ covariance @ along), bias)
        if picture.kind != WHITE:
            white = float(references.light[:, index, usable].sum(axis=0).mean())
            of_room = np.array([white * (along[0] < 0), white * (along[1] < 0), 1.0])
            room[index] = of_room @ solutions[index]
            room_error[index] = np.hypot(np.sqrt(of_room @ covariance @ of_room), bias * white)
    return CheckFit(solutions, gain, error, residual, room, room_error)


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
    """Fit counts above black; return solution (3,), residuals (n,) and covariance (3, 3).

    Pixels are weighted for photon noise. The covariance makes no assumption on the noise: HC3 of
    MacKinnon and White, Journal of Econometrics 29 (1985). Without haze, `a` is 0: in front of an
    even surface, haze cannot be distinguished from white light.
    """
    light = references.light[:, exposure, usable]
    design = np.stack([*light, np.full(light.shape[1], float(has_haze))], axis=1)
    brightness = np.maximum(light.sum(axis=0), 0)
    weight = 1 / (brightness + 0.1 * brightness.mean() + 1)
    solve = np.linalg.pinv((design.T * weight) @ design) @ (design.T * weight)
    solution = solve @ counts
    residual = counts - design @ solution
    leverage = np.einsum("ij,ji->i", design, solve)
    spread = solve * (residual / np.maximum(1 - leverage, 1e-3))
    return solution, residual, spread @ spread.T


def _noise(references: References, pairs: Sequence[tuple[CheckPicture, CheckPicture]]) -> Double:
    """Median residual between two successive pictures of one pattern, (E,)."""
    noise = np.full(len(references.exposures), np.inf)
    for index in range(len(noise)):
        residuals = []
        for first, second in pairs:
            brighter = np.maximum(first.frames[index], second.frames[index])
            usable = np.logical_and(_usable(references, index), brighter < references.saturated)
            light = references.light_of(second.kind)[index, usable]
            if usable.sum() < _LEAST_PIXELS or light.sum() <= 0:
                continue
            change = np.subtract(second.frames[index], first.frames[index], dtype=np.float64)
            _, residual_counts, _ = _regression(references, index, usable, change[usable])
            # rounding may hide the noise in these two pictures, but not in a later one
            noise_of_counts = np.square(residual_counts).mean() / 2 + _ROUNDING**2
            residuals.append(np.sqrt(noise_of_counts / np.square(light).mean()))
        # where noise hides the light itself, nothing can be compared
        if residuals and np.median(residuals) < 0.5:
            noise[index] = float(np.median(residuals))
    return noise


def common_gain(series: LightSeries, limit: float) -> tuple[Double, Double]:
    """Average the gain over the exposures of each picture, (K,); also return its error."""
    known = known_exposures(series, limit)
    # errors below 1e-4 are taken as 1e-4
    weight = 1 / (np.square(series.error[:, known]) + 1e-8)
    total = weight.sum(axis=1)
    common: Double = (weight * series.gain[:, known]).sum(axis=1) / total
    return common, 1 / np.sqrt(total)


def known_exposures(series: LightSeries, limit: float) -> NDArray[np.bool_]:
    """Select the exposures whose gain is known to a third of the limit, or else the best one."""
    worst = np.where(np.isfinite(series.gain), series.error, np.inf).max(axis=0)
    known: NDArray[np.bool_] = np.isfinite(worst) & (worst <= max(limit / 3, worst.min()))
    return known
