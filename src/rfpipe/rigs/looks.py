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
from rfpipe.units import SATURATION_FRACTION

Double = NDArray[np.float64]

BLACK, PATTERN, COMPLEMENT, WHITE = range(4)
"""Pictures of looks."""

MOST_PIXELS = 2**16
"""Photosites of a frame that are compared, at most."""

_GAIN = {PATTERN: (1, -1, 0), COMPLEMENT: (-1, 1, 0), WHITE: (0.5, 0.5, 0)}
"""Weights of the solution that make up the gain."""

_LEAST_PIXELS = 50
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
    """Fit of a look; NaN in exposures that cannot be fitted."""

    gain: Double
    gain_error: Double
    residual: Double


class Series(NamedTuple):
    """Gains of K lit looks, (K, E), and their errors; series and time of each, (K,)."""

    gain: Double
    error: Double
    series: NDArray[np.int64]
    seconds: Double


def saturated_from(sensor: CameraModel) -> float:
    """Return the counts from which on a photosite of a camera is saturated."""
    return SATURATION_FRACTION * sensor.white_level


def thinned(frames: NDArray[Any]) -> NDArray[np.float32]:
    """Return at most `MOST_PIXELS` photosites of each frame of a bracket (E, ...), (E, n)."""
    flat = frames.reshape(len(frames), -1)
    step = -(-flat.shape[1] // MOST_PIXELS) | 1  # odd: photosites of every colour of a mosaic
    return np.asarray(flat[:, ::step], np.float32)


def gains_of(looks: Sequence[Look], references: References) -> Series:
    """Return the gains of the lit looks."""
    lit = [look for look in looks if look.picture != BLACK]
    fits = [fit_of(look, references) for look in lit]
    return Series(
        np.array([fit.gain for fit in fits]),
        np.array([fit.gain_error for fit in fits]),
        np.array([look.series for look in lit]),
        np.array([look.seconds for look in lit]),
    )


def fit_of(look: Look, references: References) -> Fit:
    """Fit each exposure of a lit look."""
    exposures = len(references.exposures)
    gain, error, residual = np.full((3, exposures), np.nan)
    along = np.array(_GAIN[look.picture], np.float64)
    for index in range(exposures):
        frame = look.frames[index].astype(np.float64)
        usable = _usable(references, index) & (frame < references.saturated)
        shown = references.light_of(look.picture)[index, usable]
        if usable.sum() < _LEAST_PIXELS or not np.isfinite(references.noise[index]):
            continue
        solution, rest, covariance = _regression(
            references, index, usable, frame[usable] - references.frames[0, index, usable]
        )
        gain[index] = along @ solution
        residual[index] = np.sqrt(np.square(rest).sum() / np.square(shown).sum())
        # noise of the references bends the fit by the square of the residual
        error[index] = np.hypot(np.sqrt(along @ covariance @ along), references.noise[index] ** 2)
    return Fit(gain, error, residual)


def _usable(references: References, exposure: int) -> NDArray[np.bool_]:
    """Test which pixels no reference saturates in an exposure."""
    is_usable: NDArray[np.bool_] = (references.frames[:, exposure] < references.saturated).all(
        axis=0
    )
    return is_usable


def _regression(
    references: References, exposure: int, usable: NDArray[np.bool_], counts: Double
) -> tuple[Double, Double, Double]:
    """Return solution (3,), residuals and covariance (3, 3) of counts above black.

    Pixels have weights as of photon noise. The covariance is that of any noise: HC3 of MacKinnon
    and White, Journal of Econometrics 29 (1985).
    """
    light = references.light[:, exposure, usable]
    design = np.stack([*light, np.ones(light.shape[1])], axis=1)
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
            usable = _usable(references, index)
            brighter = np.maximum(first.frames[index], second.frames[index])
            usable = np.logical_and(usable, brighter < references.saturated)
            light = references.light_of(second.picture)[index, usable]
            if usable.sum() < _LEAST_PIXELS or light.sum() <= 0:
                continue
            difference = (second.frames[index] - first.frames[index]).astype(np.float64)[usable]
            _, rest, _ = _regression(references, index, usable, difference)
            residuals.append(np.sqrt(np.square(rest).sum() / 2 / np.square(light).sum()))
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
