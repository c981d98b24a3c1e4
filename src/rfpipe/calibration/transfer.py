"""The photon-transfer curve: gain, read noise and full well, from pairs of pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Verdict, take, uniform
from rfpipe.calibration.dark import Dark
from rfpipe.calibration.noise_fit import Bins, NoiseFit, fit_noise
from rfpipe.errors import CaptureError
from rfpipe.photometry.defects import MAD_TO_DEVIATION
from rfpipe.photometry.response import Response
from rfpipe.rigs.devices import Camera, Projector

__all__ = [
    "Transfer",
    "levels_of",
    "measure_transfer",
    "take_levels",
    "transfer_facts",
    "transfer_verdict",
]

Double = NDArray[np.float64]

RATIO = 1.12
"""Width of a bin: its upper edge over its lower one."""

LEAST_WIDTH = 2.0
"""Counts that a bin is wide at least: then rounding meets all fractions of a count in it."""

LEAST_PAIRS = 10
"""Pairs of photosites in a bin that is used."""

HIDDEN = 0.4
"""Variance in counts squared, rounding included, below which rounding hides noise."""

PHASES = 8
"""Fractions of a count that rounding is averaged over, each with the same weight."""

FINER = 10.0
"""A signal is known finer than rounding where all exposures together are this many times longer."""

ABOVE_DARK = 4.0
"""Deviations of noise that a bin's signal lies above darkness."""

SAFE = 0.9
"""Fraction of full scale up to which an exposure tells the signal of the others."""

MOST_IN_DARK = 0.1
"""Fraction of full scale that dark frames may have: of more, some photosites are saturated."""

CLIP = 6.0
"""Standard deviations from which on a difference is no noise (a cosmic ray, a moving thing)."""

WANTED = 0.1
"""Relative error of the noise, bright or dark, that the merge's weights and tests bear."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """What pairs of pictures tell of the camera.

    Attributes
    ----------
    fit : NoiseFit
        Gain and read noise, with their standard errors.
    bins : Bins
        The curve: mean signal and variance between the two pictures of a pair, in counts.
    used : ndarray of bool
        Bins that the fit used; the others are near saturation or hold too few pairs.
    saturation : float
        Counts above which the camera gives none, or full scale where that wasn't reached.
    saturated : bool
        Whether saturation was reached.
    span : float
        Counts from black level to full scale.
    """

    fit: NoiseFit
    bins: Bins
    used: NDArray[np.bool_]
    saturation: float
    saturated: bool
    span: float

    @property
    def full_well(self) -> float:
        """Electrons at full scale."""
        return self.fit.gain * self.span


def levels_of(count: int) -> list[float]:
    """Return weights of flat pictures, geometric from 1/256 to 1: few counts up to all of them."""
    return np.geomspace(1 / 256, 1, count).tolist() if count > 1 else [1.0]


def take_levels(
    projector: Projector, camera: Camera, levels: Sequence[float], repeats: int
) -> Iterator[NDArray[Any]]:
    """Take each level's pictures, yielded together: (repeats, E, ...)."""
    for level in levels:
        pictures = (uniform(projector, level) for _ in range(repeats))
        yield np.stack(list(take(projector, camera, pictures)))


def measure_transfer(
    levels: Iterable[NDArray[Any]],
    dark: Dark,
    exposures: Sequence[float],
    white_level: int,
    response: Response | None = None,
) -> Transfer:
    """Measure gain and read noise.

    Parameters
    ----------
    levels : iterable of ndarray of uint16, shape (K, E, ...)
        K pictures each, two or more, of the same light; what is seen need not be flat, for fixed
        differences between photosites cancel in a pair's difference.
    dark : Dark
    exposures : sequence of float
        Seconds.
    white_level : int
        Full scale in counts.
    response : Response, optional
        Of a camera that isn't linear: the curve is that of linearised counts.

    Returns
    -------
    Transfer

    Raises
    ------
    CaptureError
        When there is no pair, or no light between darkness and saturation.

    Notes
    -----
    The variance of a pair's difference is twice that of one picture [EMVA 1288]. Photosites of all
    exposures and levels are sorted by their mean signal into bins; the mean difference of a bin is
    subtracted, so that a lamp that flickers between the two pictures adds no noise.
    """
    span = white_level - dark.black_level_counts
    times = np.asarray(exposures, float)
    edges = _edges(span)
    total = Bins.none(len(edges) - 1)
    fine = Bins.none(PHASES * total.pairs.size)
    counts = np.zeros(white_level + 1, np.int64)
    current = dark.current_counts_per_s * times
    good = ~dark.hot
    for frames in levels:
        if len(frames) < 2:
            raise CaptureError(f"a level holds {len(frames)} picture; expected pairs, 2 or more")
        counts += np.bincount(frames[:, :, good].ravel(), minlength=len(counts))[: len(counts)]
        for first in range(0, len(frames) - 1, 2):
            raw = frames[first : first + 2][:, :, good]
            pair = _linear(raw, dark, good, response, span)
            light, finer = _pooled(pair, raw < SAFE * white_level, times)
            for k in range(len(times)):
                # a photosite's own, fixed differences between them averaging to zero; what a
                # response was undone of has it in it
                glow = dark.black[k][good] - dark.black_level_counts
                if response is not None:
                    glow = np.zeros_like(glow)
                # by all light: what the all-off picture all but saturates has no noise to show
                signal = pair[:, k].mean(axis=0) + glow
                total = total.plus(
                    _binned(pair[:, k], signal, _bin_of(signal, edges), len(total.pairs))
                )
                known = finer[k]
                signal = times[k] * light[known]
                phase = (signal + dark.black[k][good][known]) % 1
                signal = signal + glow[known]
                at = PHASES * _bin_of(signal, edges) + (PHASES * phase).astype(int)
                finely = _binned(pair[:, k][:, known], signal, at, len(fine.pairs))
                fine = fine.plus(finely)
    saturation, saturated = _saturation(counts, white_level)
    # where rounding hides noise, the two pictures' own mean tells whether they differ: there,
    # longer exposures have to tell the signal
    total = total.replaced_by(fine.averaged(PHASES), total.variance < HIDDEN)
    total = replace(total, steps=_steps(total.signal, response, span))
    used = _usable(total, _limit(saturation, dark.black_level_counts, response, span))
    if used.sum() < 2:
        raise CaptureError(
            "the flat pictures hold no light between darkness and saturation; check projector and "
            "lens, or choose other exposures"
        )
    of_dark = _dark_bins(dark, current, span) if response is None else None
    fit = fit_noise(total.chosen(used), of_dark)
    return Transfer(fit, total, used, saturation, saturated, span)


def transfer_facts(transfer: Transfer, dark: Dark) -> Findings:
    """Return the step's findings: numbers for the camera model, curve and verdict."""
    fit, bins = transfer.fit, transfer.bins
    facts = {
        "electrons_per_count": fit.gain,
        "electrons_per_count_error": fit.gain_error,
        "read_noise_electrons": fit.read_noise,
        "read_noise_error": fit.read_noise_error,
        "full_well_electrons": transfer.full_well,
        "dark_current_electrons": max(0.0, dark.current_counts_per_s * fit.gain),
        "dark_current_error": dark.current_error * fit.gain,
        "saturation_counts": transfer.saturation,
        "saturated": transfer.saturated,
        "misfit": fit.misfit,
        "pairs": int(bins.pairs.sum()),
    }
    arrays = {
        "ptc_signal": bins.signal,
        "ptc_variance": bins.variance,
        "ptc_error": bins.error,
        "ptc_model": fit.predicted(bins),
        "ptc_used": transfer.used,
    }
    return Findings(transfer_verdict(transfer), facts, arrays)


def transfer_verdict(transfer: Transfer) -> Verdict:
    """Say whether the numbers are known to `WANTED`, and whether the curve is one of photons."""
    fit = transfer.fit
    gain_error = fit.gain_error / fit.gain
    # what counts is the noise of darkness, to which the converter's steps belong
    darkness = fit.read_noise**2 + fit.gain**2 / 12
    read_error = fit.read_noise * fit.read_noise_error / darkness
    numbers = (
        f"{fit.gain:.3g} +- {fit.gain_error:.2g} electrons a count, read noise "
        f"{fit.read_noise:.3g} +- {fit.read_noise_error:.2g} electrons"
    )
    if fit.misfit > WANTED:
        return Verdict(
            "poor",
            f"The variance misses that of photons by {fit.misfit:.0%}; {numbers}. Is the camera "
            "linear, its gamma and noise reduction off, the light steady?",
        )
    if 2 * max(gain_error, read_error) > WANTED:
        return Verdict(
            "unknown",
            f"Too few pairs to know the noise within {WANTED:.0%}: {numbers}. Take more pictures a "
            "level, or more levels.",
        )
    return Verdict("good", f"Known well enough for the merge: {numbers}.")


def _edges(span: float) -> Double:
    """Return edges of the bins, a quarter above whole counts: first that of darkness."""
    edges = [-np.inf, 1.25]
    while edges[-1] < span:
        edges.append(np.floor(max(edges[-1] * RATIO, edges[-1] + LEAST_WIDTH)) + 0.25)
    return np.array(edges)


def _linear(
    raw: NDArray[Any],
    dark: Dark,
    good: NDArray[np.bool_],
    response: Response | None,
    span: float,
) -> Double:
    """Return the signal of counts (2, E, n), in linear counts."""
    if response is None:
        return np.asarray(raw - dark.black[:, good].astype(np.float64))
    return np.asarray(span * response.linearise((raw - dark.black_level_counts) / span))


def _pooled(
    pair: Double, usable: NDArray[np.bool_], times: Double
) -> tuple[Double, NDArray[np.bool_]]:
    """Return the signal a second (n,) by all usable exposures, and where that is finer (E, n)."""
    both = usable.all(axis=0)
    length = (both * times[:, None]).sum(axis=0)
    light = (pair.mean(axis=0) * both).sum(axis=0) / np.maximum(length, times[0])
    return light, both & (length >= FINER * times[:, None])


def _bin_of(signal: Double, edges: Double) -> NDArray[np.intp]:
    """Return the bin of each signal."""
    return np.clip(np.searchsorted(edges, signal) - 1, 0, len(edges) - 2)


def _binned(pair: Double, signal: Double, at: NDArray[np.intp], count: int) -> Bins:
    """Gather a pair of pictures (2, n) in bins, by the bin (n,) of each photosite."""
    order = np.argsort(at, kind="stable")
    difference, signal = (pair[1] - pair[0])[order], signal[order]
    bounds = np.searchsorted(at[order], np.arange(count + 1))
    result = Bins.none(count)
    for index, (first, last) in enumerate(pairwise(bounds)):
        if last - first < 2:
            continue
        part = difference[first:last]
        centre = np.median(part)
        deviation = MAD_TO_DEVIATION * np.median(np.abs(part - centre))
        kept = np.abs(part - centre) <= CLIP * max(deviation, 1.0)
        if kept.sum() < 2:
            continue
        part = part[kept]
        # the mean difference takes one of the pairs' degrees of freedom
        squares = (part - part.mean()) ** 2 / 2 * (len(part) / (len(part) - 1))
        result.pairs[index] = len(part)
        result.signals[index] = signal[first:last][kept].sum()
        result.squares[index] = squares.sum()
        result.fourths[index] = (squares**2).sum()
    return result


def _saturation(counts: NDArray[np.int64], white_level: int) -> tuple[float, bool]:
    """Return the count at which photosites pile up, and whether they do."""
    top = int(np.flatnonzero(counts)[-1])
    below = counts[max(0, top - 40) : max(1, top - 8)]
    piled = int(counts[max(0, top - 8) :].sum())
    if top >= white_level or piled > 10 * max(1.0, 8 * float(below.mean())):
        return float(top), True
    return float(white_level), False


def _limit(saturation: float, black: float, response: Response | None, span: float) -> float:
    """Return the signal, in linear counts, that saturates."""
    level = (saturation - black) / span
    return span * (level if response is None else float(response.linearise(np.array(level))))


def _steps(signal: Double, response: Response | None, span: float) -> Double:
    """Return the converter's step at a signal, in linear counts: 1 for a linear camera."""
    if response is None:
        return np.ones_like(signal)
    level = np.linspace(0, 1, int(span) + 1)
    light = span * response.linearise(level)
    return np.interp(signal, light, np.gradient(light))


def _usable(bins: Bins, limit: float) -> NDArray[np.bool_]:
    """Choose bins with enough pairs, above darkness, and too low to be cut off by saturation."""
    enough = bins.pairs >= LEAST_PAIRS
    enough[0] = False
    # darker photosites that noise lifted into a bin have less noise than its signal says
    above = bins.signal > ABOVE_DARK * np.sqrt(bins.variance)
    spread = np.sqrt(np.maximum.accumulate(np.where(enough, bins.variance, 0)))
    return np.asarray(enough & above & (bins.signal * RATIO + CLIP * spread < limit))


def _dark_bins(dark: Dark, current: Double, span: float) -> Bins:
    """Return the dark frames as bins of next to no signal, those that light fills left out."""
    bare = current < MOST_IN_DARK * span
    current, variance = current[bare], np.maximum(dark.variance, 0)[bare]
    pairs = np.full(len(current), float((dark.frames - 1) * (~dark.hot).sum()))
    return Bins(
        pairs, pairs * current, pairs * variance, pairs * 3 * variance**2, np.ones_like(pairs)
    )
