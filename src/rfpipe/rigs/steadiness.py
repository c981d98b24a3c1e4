"""Unsteady rigs: late frames, changing gain, flicker, room light, drift of the lamp, and motion.

A *look* is the bracket of one of three pictures: black B, a pattern P, or its complement Q. With a
reference R of each, the counts F of an exposure are fitted over the camera's pixels by ::

    F = R_B + x_P (R_P - R_B) + x_Q (R_Q - R_B) + a

======== ================= ========= ==========================================================
symbol   name              shape     meaning
======== ================= ========= ==========================================================
F        frames            (E, n)    counts of n camera pixels, unsaturated ones in the fit
R        references        (3, E, n) the same, of B, P and Q
x, a     solution          (3,)      of one exposure
g        gain              (E,)      ``x_P - x_Q`` of a look at P, ``x_Q - x_P`` of a look at Q
r        residual          (E,)      RMS of what the fit leaves, relative to the light of P or Q
======== ================= ========= ==========================================================

What the rig does is read from the fits of many looks:

- Gain and lamp multiply: g changes. Light of the room adds: to `a` as haze, and to x_P and x_Q
  alike where the scene reflects it, since ``P + Q`` is a white picture. It does not change g, but
  it changes the looks at black.
- The gain of a bracket is common to its exposures. Flicker is not: it is random in each exposure,
  and vanishes in those of whole periods.
- A lamp drifts slowly: adjacent looks agree, distant ones do not.
- Motion changes the picture's shape: r rises.
- Late frames agree with the reference of the look before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.camera import CameraModel
from rfpipe.units import SATURATION_FRACTION

Double = NDArray[np.float64]
Kind = Literal["late", "room", "moved", "gain", "flicker", "unsteady", "drift"]

BLACK, PATTERN, COMPLEMENT = 0, 1, 2
"""Pictures of looks."""

MOST_PIXELS = 2**16
"""Photosites of a frame that are compared, at most."""

_LEAST_PIXELS = 50
_HEADROOM = 0.8  # counts of references over saturation: a brighter look does not saturate
_SIGNIFICANCE = 6.0  # standard errors beyond which a change is no noise
_MOVED = 0.05  # residual from which on a picture has another shape: half a pixel makes 0.15
_ROOM = 0.2  # change of room light over that of the lamp's that is accepted: it is in all pictures
_LATE = 0.5  # distance to the picture before over that to the picture shown
_COMMON = 0.1  # share of the gains' variance within brackets, below which it is of whole brackets
_AVERAGED_SECONDS = 0.05  # exposures from which on flicker at mains frequency is small


class Fault(NamedTuple):
    """A fault of a rig.

    Attributes
    ----------
    kind : str
    size : float
        Relative change of light or picture.
    text : str
        What is wrong, and what to do.
    """

    kind: Kind
    size: float
    text: str


@dataclass(frozen=True, eq=False)
class Look:
    """A bracket of a known picture.

    Attributes
    ----------
    picture : {BLACK, PATTERN, COMPLEMENT}
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
    """

    frames: Double
    noise: Double
    exposures: tuple[float, ...]
    saturated: float
    seconds: float

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
        return self.frames[1:] - self.frames[0]

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


def faults_of(looks: Sequence[Look], references: References, limit: float) -> list[Fault]:
    """Return the faults that looks show, in the order of mending.

    Looks without light, such as those under a lens cap, show none.

    Parameters
    ----------
    looks : sequence of Look
        In the order of taking.
    references : References
    limit : float
        Relative change of the lamp's light that is accepted.
    """
    if not references.has_light or _are_dark(looks, references):
        return []
    late = _late(looks, references)
    if late is not None:
        return [late]
    faults = [_room(looks, references, limit), _moved(looks, references)]
    if faults[1] is None:  # gains of another picture mean nothing
        faults.append(light_fault(gains_of(looks, references), references.exposures, limit))
    return [fault for fault in faults if fault is not None]


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
    """Fit each exposure of a look at the pattern or its complement."""
    exposures = len(references.exposures)
    gain, error, residual = np.full((3, exposures), np.nan)
    sign = 1 if look.picture == PATTERN else -1
    for index in range(exposures):
        frame = look.frames[index].astype(np.float64)
        usable = _usable(references, index) & (frame < references.saturated)
        shown = references.light[look.picture - 1, index, usable]
        if usable.sum() < _LEAST_PIXELS or not np.isfinite(references.noise[index]):
            continue
        solution, rest, covariance = _regression(
            references, index, usable, frame[usable] - references.frames[0, index, usable]
        )
        along = np.array([sign, -sign, 0.0])
        gain[index] = along @ solution
        residual[index] = np.sqrt(np.square(rest).sum() / np.square(shown).sum())
        # noise of the references bends the fit by the square of the residual
        error[index] = np.hypot(np.sqrt(along @ covariance @ along), references.noise[index] ** 2)
    return Fit(gain, error, residual)


def light_fault(series: Series, exposures: Sequence[float], limit: float) -> Fault | None:
    """Return the fault of the light that multiplies: gain, flicker or drift; None for none.

    Parameters
    ----------
    series : Series
        Gains relative to a reference; NaN where an exposure is unknown.
    exposures : sequence of E floats
        Seconds.
    limit : float
        Accepted range of the gains.
    """
    known = _known(series, limit)
    if not known.any() or len(series.gain) < 2:
        return None
    gain, error, times = series.gain[:, known], series.error[:, known], np.array(exposures)[known]
    span = np.ptp(gain, axis=0)
    is_change = (span > limit) & (span > _SIGNIFICANCE * error.max(axis=0))
    if not is_change.any():
        return None
    size = float(span[is_change].max())
    common, common_error = common_gain(series, limit)
    noise = np.square(error).mean(axis=0)
    variance = np.maximum(gain.var(axis=0) - noise, 0)
    within = np.square(gain - common[:, None]).mean(axis=0) - noise
    if len(times) > 1 and within.max() > _COMMON * variance.max():
        # flicker is averaged in long exposures, a gain is not
        is_averaged = times[-1] < max(_AVERAGED_SECONDS, 4 * times[0]) or (
            variance[-1] < variance.max() / 4
        )
        return flicker_fault(size, exposures) if is_averaged else gain_fault(size)
    if _is_slow(series, common, common_error, limit):
        order = np.argsort(series.seconds)
        change = float(common[order[-1]] / common[order[0]] - 1)
        return drift_fault(change, float(np.ptp(series.seconds)))
    if len(times) == 1 and not is_whole_period(times[0]):
        return unsteady_fault(size)
    return gain_fault(size)


def gain_fault(size: float) -> Fault:
    """Return the fault of a gain that changes from picture to picture by `size`."""
    return Fault(
        "gain",
        size,
        f"The camera's gain changes from picture to picture, by {size:.1%}, in all exposures "
        "alike: switch automatic gain, exposure and brightness off, in the camera and in its "
        "driver",
    )


def drift_fault(change: float, seconds: float) -> Fault:
    """Return the fault of a lamp whose light changed by `change` in `seconds`."""
    return Fault(
        "drift",
        abs(change),
        f"The lamp's light changed by {change:+.1%} in {seconds:.2g} s: let the lamp warm up, half "
        "an hour or more",
    )


def late_fault(share: float) -> Fault:
    """Return the fault of frames of the picture before, in a share of the pictures."""
    return Fault(
        "late",
        share,
        "The camera's frames are of the picture before: empty the camera's queue before each "
        "bracket, such as by single-frame triggers in place of a running stream; or, where the "
        "display is slow, raise projector.options.settle_seconds (the latency)",
    )


def room_fault(size: float, seconds: float) -> Fault:
    """Return the fault of room light that changes by `size`, relative to the projector's white."""
    return Fault(
        "room",
        size,
        f"The room's light changes by {size:.2%} of the projector's in {seconds:.2g} s: darken the "
        "room, cover windows and screens, and switch lamps off",
    )


def moved_fault(size: float) -> Fault:
    """Return the fault of a picture that changed its shape by `size`, relative to its norm."""
    return Fault(
        "moved",
        size,
        f"The picture of the same pattern differs by {size:.0%} from the one before, and not in "
        "brightness: the camera, the projector or the scene moved, or the projector's picture is "
        "mirrored, scaled or cut off. Fix them, check the projector's cable and menu, and "
        "calibrate again",
    )


def flicker_fault(size: float, exposures: Sequence[float]) -> Fault:
    """Return the fault of a lamp whose flicker changes exposures by up to `size`."""
    at_50 = ", ".join(f"{each:g}" for each in whole_periods(exposures, 100))
    at_60 = ", ".join(f"{each:.3g}" for each in whole_periods(exposures, 120))
    return Fault(
        "flicker",
        size,
        f"The lamp flickers: exposures differ by up to {size:.1%}, the short ones most. Take "
        f"exposures of whole periods, as sensor.exposures: [{at_50}] where mains have 50 Hz, "
        f"[{at_60}] where they have 60 Hz; or a lamp without flicker",
    )


def unsteady_fault(size: float) -> Fault:
    """Return the fault of light that changes by `size`, where one exposure can't say why."""
    return Fault(
        "unsteady",
        size,
        f"The light changes from picture to picture by {size:.1%}. Either the camera's gain "
        "changes: switch automatic gain, exposure and brightness off. Or the lamp flickers: take "
        "exposures of whole periods, multiples of 1/100 s where mains have 50 Hz, of 1/120 s where "
        "they have 60 Hz. A bracket of two exposures, a few times apart, shows which it is",
    )


def whole_periods(exposures: Sequence[float], hertz: float) -> list[float]:
    """Return the multiples of a period that are next to exposures, ascending and all different."""
    periods: list[int] = []
    for exposure in sorted(exposures):
        least = periods[-1] + 1 if periods else 1
        periods.append(max(least, round(exposure * hertz)))
    return [number / hertz for number in periods]


def is_whole_period(exposure: float) -> bool:
    """Test whether an exposure has whole periods of flicker at 100 Hz and at 120 Hz."""
    return all(abs(exposure * hertz - round(exposure * hertz)) < 0.02 for hertz in (100, 120))


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
            usable &= np.maximum(first.frames[index], second.frames[index]) < references.saturated
            light = references.light[second.picture - 1, index, usable]
            if usable.sum() < _LEAST_PIXELS or light.sum() <= 0:
                continue
            difference = (second.frames[index] - first.frames[index]).astype(np.float64)[usable]
            _, rest, _ = _regression(references, index, usable, difference)
            residuals.append(np.sqrt(np.square(rest).sum() / 2 / np.square(light).sum()))
        # where noise hides the light itself, nothing can be compared
        if residuals and np.median(residuals) < 0.5:
            noise[index] = float(np.median(residuals))
    return noise


def _are_dark(looks: Sequence[Look], references: References) -> bool:
    """Test whether all lit looks are black."""
    black = references.frames[BLACK]
    return all(
        _distance(frame, black) < _LATE * _distance(frame, references.frames[look.picture])
        for look in looks
        if look.picture != BLACK
        for frame in look.frames[:1]
    )


def _late(looks: Sequence[Look], references: References) -> Fault | None:
    """Return the fault of frames that agree with the reference of the look before."""
    judged, late = 0, 0
    for before, look in pairwise(looks):
        if before.series == look.series and before.picture != look.picture:
            judged += 1
            late += any(
                _distance(frame, references.frames[before.picture])
                < _LATE * _distance(frame, references.frames[look.picture])
                for frame in look.frames
            )
    return late_fault(late / judged) if late else None


def _distance(frame: NDArray[np.float32], references: Double) -> float:
    """Return the least distance of a frame (n,) from references (E, n) of all exposures."""
    return float(np.sqrt(np.square(frame - references).mean(axis=1).min()))


def _room(looks: Sequence[Look], references: References, limit: float) -> Fault | None:
    """Return the fault of black pictures that differ, by the longest exposure that shows it."""
    dark = [look for look in looks if look.picture == BLACK]
    seconds = np.array([references.seconds, *(look.seconds for look in dark)])
    for index in range(len(references.exposures))[::-1]:
        frames = np.array([references.frames[BLACK, index], *(look.frames[index] for look in dark)])
        usable = (frames < references.saturated).all(axis=0)
        if usable.mean() < 0.5:
            continue
        rates = frames[:, usable].mean(axis=1) / references.exposures[index]
        least, most = int(rates.argmin()), int(rates.argmax())
        change = (frames[most] - frames[least])[usable]
        is_noise = change.mean() < _SIGNIFICANCE * change.std() / np.sqrt(change.size)
        size = float(rates[most] - rates[least]) / references.white_rate
        if is_noise or size < _ROOM * limit:
            return None
        return room_fault(size, float(abs(seconds[most] - seconds[least])))
    return None


def _moved(looks: Sequence[Look], references: References) -> Fault | None:
    """Return the fault of a picture that has another shape than its reference."""
    best = int(np.argmin(references.noise))
    lit = [look for look in looks if look.picture != BLACK]
    residual = max((fit_of(look, references).residual[best] for look in lit), default=np.nan)
    is_moved = residual > _MOVED + 3 * references.noise[best]
    return moved_fault(float(residual)) if is_moved else None


def common_gain(series: Series, limit: float) -> tuple[Double, Double]:
    """Return the gain (K,) that the exposures of each look have in common, and its error."""
    known = _known(series, limit)
    # an error below 1e-4 is not believed
    weight = 1 / (np.square(series.error[:, known]) + 1e-8)
    total = weight.sum(axis=1)
    common: Double = (weight * series.gain[:, known]).sum(axis=1) / total
    return common, 1 / np.sqrt(total)


def _known(series: Series, limit: float) -> NDArray[np.bool_]:
    """Test which exposures are known to a third of the limit; the best one, if none is."""
    worst = np.where(np.isfinite(series.gain), series.error, np.inf).max(axis=0)
    known: NDArray[np.bool_] = np.isfinite(worst) & (worst <= max(limit / 3, worst.min()))
    return known


def _is_slow(series: Series, common: Double, error: Double, limit: float) -> bool:
    """Test whether adjacent looks (K,) agree, or differ by no more than a steady drift."""
    adjacent = np.diff(series.series) == 0
    if not adjacent.any():
        return False
    step = np.diff(common)[adjacent]
    share = np.diff(series.seconds)[adjacent].mean() / max(np.ptp(series.seconds), 1e-9)
    expected = max(limit / 2, 2 * share * float(np.ptp(common)))
    return bool(np.square(step).mean() - 2 * np.square(error).mean() < expected**2)
