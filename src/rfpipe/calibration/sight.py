"""What the camera sees: the projector's outline, what is saturated or too dark, how sharp it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Float, Measured, Verdict

__all__ = [
    "PICTURES",
    "SATURATED",
    "Sight",
    "measure_sight",
    "proposed_exposures",
    "sight_findings",
    "sight_pictures",
]

Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

SATURATED = 0.98
"""Fraction of full scale from which on counts are saturated, as in the merge."""

MOST_SATURATED = 0.01
"""Share of the lit pixels that may be saturated at the shortest exposure: glints, no surfaces."""

LEAST_LEVEL = 0.1
"""Fraction of full scale that the brighter lit pixels reach at least at the longest exposure."""

BRIGHTEST, BRIGHTER = 99.5, 90.0
"""Percentiles of the lit pixels' light that exposures are chosen for, and judged dark by."""

AIM = 0.75
"""Fraction of full scale that the brightest pixels are to have at the shortest exposure."""

MOST_GLOW = 0.25
"""Fraction of full scale that the light of the all-off picture may fill at the longest one."""

SIGNIFICANCE = 5.0
DIM_CODES = (16, 32, 64, 128)
"""Codes of dimmer flat pictures: how much too bright is what white saturates."""

USUAL_GAMMA = 2.2
REPEATS = 2
COARSER = 4
OWN = 0.4
"""Contrast of the wide stripes of a pixel that sees the projector itself, not what it scatters."""

TOLD = 0.01
"""Veil that is worth a word."""

LEAST_LIT = 25
MOST_SECONDS = 60.0

PICTURES = 2 * REPEATS + len(DIM_CODES) + 6
"""Pictures that `sight_pictures` yields."""


@dataclass(frozen=True, eq=False)
class Sight(Measured):
    """What the camera sees; all arrays are of its frame, colour channels taken together.

    Attributes
    ----------
    white, black : ndarray of float32
        Counts a second of the projector's full light, black taken off, from each pixel's longest
        exposure that isn't saturated; counts of the all-off picture at the longest exposure.
    lit : ndarray of bool
        Where the projector's own light falls, known by wide stripes.
    saturated, dark : ndarray of bool
        Lit pixels that are saturated even at the shortest exposure, and those that stay within the
        noise even at the longest one.
    focus : ndarray of float32
        Contrast of fine stripes over that of wide ones, 1 where neither lens nor pixel blurs them;
        NaN where nothing is lit.
    brightest, brighter : float
        Counts a second of the brightest lit pixels, glints left out, and of the brighter ones.
    is_extrapolated : bool
        Whether the brightest were measured under dimmer pictures only, of a usual gamma.
    black_full : float
        Share of the picture that is saturated at the shortest exposure without the projector.
    black_level, glow : float
        Counts without light at no exposure time, and counts a second under the all-off picture;
        medians over pixels.
    veil : float
        White's light well beyond the projector's outline over its mean: flare of the lens, or what
        the scene reflects there; None where nothing lies beyond.
    stripes_pixels : int
        Period of the fine stripes in projector pixels.
    """

    white: Float
    black: Float
    lit: Mask
    saturated: Mask
    dark: Mask
    focus: Float
    brightest: float
    brighter: float
    is_extrapolated: bool
    black_full: float
    black_level: float
    glow: float
    veil: float | None
    stripes_pixels: int


def sight_pictures(shape: tuple[int, int], period: int) -> Iterator[Float]:
    """Yield the pictures: off, white, dimmer ones; stripes, fine ones along x and y, and wide ones.

    All but the dimmer ones are of codes 0 and 255: the projector's response isn't known yet.
    """
    for code in (*[0] * REPEATS, *[255] * REPEATS, *DIM_CODES):
        yield np.full(shape, code / 255, np.float32)
    y, x = np.mgrid[: shape[0], : shape[1]]
    # a few at least, so that flare, which goes with a picture's mean, is the same in all
    wide = max(2 * period, min(COARSER * period, shape[1] // COARSER))
    for along, pixels in ((x, period), (y, period), (x, wide)):
        for quarter in (0, 1):
            phase = (along + 0.5 - quarter * pixels / 4) % pixels
            yield (phase < pixels / 2).astype(np.float32)


def measure_sight(
    brackets: Sequence[NDArray[np.uint16]],
    exposures: Sequence[float],
    white_level: int,
    period: int,
) -> Sight:
    """Measure what the camera sees.

    Parameters
    ----------
    brackets : sequence of ndarray of uint16, shape (E, H, W[, C])
        Of `sight_pictures`.
    exposures : sequence of float
        Seconds.
    white_level : int
        Full scale in counts.
    period : int
        Of the fine stripes in projector pixels.
    """
    frames = np.stack([_grey(bracket) for bracket in brackets])
    is_full = np.stack([_full(bracket, white_level) for bracket in brackets])
    off, on = frames[:REPEATS], frames[REPEATS : 2 * REPEATS]
    dim, stripes = np.split(frames[2 * REPEATS :], [len(DIM_CODES)])
    black, times = off.mean(axis=0), np.asarray(exposures, float)
    full: Mask = np.any(is_full[: 2 * REPEATS], axis=0)
    off_full: Mask = np.any(is_full[:REPEATS], axis=0)
    # noise of darkness, and that of light where black is full of it
    noise = np.sqrt(np.square(off[0] - off[1]).mean(axis=(1, 2)) / 2 + 1 / 12)
    signal = on.mean(axis=0) - black
    best = np.maximum((~full).sum(axis=0) - 1, 0)  # the longest exposure that isn't full
    rates = _at(signal / times[:, None, None], best)
    modulations = _modulations(stripes, on.mean(axis=0) + black, best)
    seen: Mask = np.asarray((signal > SIGNIFICANCE * noise[:, None, None]) & ~off_full)
    seen = np.asarray(seen.any(axis=0))
    fine = np.maximum(np.minimum(modulations[0], modulations[1]), 0)
    wide = modulations[2]
    floor = SIGNIFICANCE * noise[best] * 2
    reach = max(float(_at(signal, best).max()), 0.0)
    own: Mask = np.asarray((wide > floor) & (wide > OWN * _at(signal, best)) & (reach > 0))
    lit = _filled(own)
    saturated = lit & full[0]
    focus = np.divide(fine, wide, out=np.full(wide.shape, np.nan), where=lit & (wide > floor))
    bright = np.where(full[0], 0, rates)
    extrapolated = _extrapolated(
        rates, dim - black, is_full[2 * REPEATS :][: len(dim)], full[0], times, noise
    )
    bright = np.where(saturated, extrapolated, bright)
    of_lit = bright[lit] if lit.sum() >= LEAST_LIT else bright.ravel()
    brightest, brighter = (max(float(np.percentile(of_lit, p)), 0) for p in (BRIGHTEST, BRIGHTER))
    clear = (~off_full).sum(axis=0) - 1
    slope = (_at(black, np.maximum(clear, 0)) - black[0]) / np.maximum(
        times[np.maximum(clear, 0)] - times[0], 1e-12
    )
    glow = max(float(np.median(slope[clear > 0])), 0.0) if (clear > 0).any() else 0.0
    return Sight(
        rates.astype(np.float32),
        black[-1].astype(np.float32),
        lit,
        saturated,
        lit & ~seen,
        np.clip(focus, 0, 1).astype(np.float32),
        brightest,
        brighter,
        bool(saturated.sum() > (1 - BRIGHTEST / 100) * max(lit.sum(), 1)),
        float(off_full[0].mean()),
        max(float(np.median(black[0])) - glow * float(times[0]), 0.0),
        glow,
        _veil(np.where(saturated, extrapolated, rates), lit),
        period,
    )


def proposed_exposures(sight: Sight, exposures: Sequence[float], span: float) -> list[float]:
    """Propose a bracket: as many exposures, as far apart, the brightest pixels just below full.

    Parameters
    ----------
    sight : Sight
    exposures : sequence of float
        Seconds.
    span : float
        Counts from black to full scale.

    Returns
    -------
    list of float
        Seconds, rounded; none longer than what the light of the all-off picture leaves room for.
        The given ones where nothing is seen.
    """
    if sight.brightest <= 0:
        return [float(one) for one in exposures]
    factor = AIM * span / sight.brightest / exposures[0]
    longest = MOST_SECONDS
    if sight.glow > 0:
        longest = min(longest, max(MOST_GLOW * span / sight.glow, AIM * span / sight.brightest))
    scaled = [float(f"{one * factor:.2g}") for one in exposures]
    kept = [one for one in scaled if one <= longest * 1.05]
    return list(dict.fromkeys(kept or [float(f"{min(scaled[0], longest):.2g}")]))


def sight_findings(sight: Sight, exposures: Sequence[float], white_level: int) -> Findings:
    """Return the step's findings: a poor verdict where it is too bright, too dark, or nothing."""
    span = white_level - min(sight.black_level, 0.5 * white_level)
    lit = int(sight.lit.sum())
    share = float(sight.saturated.sum()) / max(lit, 1)
    over = sight.brightest * exposures[0] / (SATURATED * span)
    level = sight.brighter * exposures[-1] / span
    proposal = proposed_exposures(sight, exposures, span)
    told = ", ".join(f"{one:g}" for one in proposal)
    faults = []
    if sight.black_full > MOST_SATURATED:
        faults.append(
            f"The all-off picture itself saturates {sight.black_full:.0%} of the camera's pixels "
            f"at the shortest exposure, {exposures[0]:.3g} s: darken the room, or the projector "
            "is not black when it is off."
        )
    elif share > MOST_SATURATED:
        about = "about " if sight.is_extrapolated else ""
        faults.append(
            f"{share:.1%} of the pixels that the projector lights are saturated even at the "
            f"shortest exposure, {exposures[0]:.3g} s: the brightest are {about}{over:.2g} times "
            f"too bright. Add shorter exposures, as sensor.exposures: [{told}], close the "
            "aperture, or dim the projector."
        )
    elif level < LEAST_LEVEL:
        faults.append(_dark(lit, level, exposures, told))
    elif lit < LEAST_LIT:
        faults.append(
            "The camera sees light, but no stripes of the projector: focus both, and turn the "
            "camera to what the projector lights."
        )
    focus = float(np.nanmedian(sight.focus)) if lit and np.isfinite(sight.focus).any() else None
    text = (
        f"The projector lights {sight.lit.mean():.0%} of the picture; white reaches "
        f"{min(over * SATURATED, 1):.0%} of full scale at the shortest exposure and would reach "
        f"{level:.2g} times full scale at the longest."
    )
    if focus is not None:
        text += (
            f" Stripes of {sight.stripes_pixels} projector pixels keep {focus:.0%} of their "
            "contrast."
        )
    if sight.veil is not None and sight.veil > TOLD:
        text += (
            f" Beyond the projector's outline there is {sight.veil:.1%} of white's mean light: "
            "flare of the lens, which every picture has, or what the scene reflects."
        )
    text += _leaving(sight.lit)
    return sight.findings(
        Verdict.of(faults, text),
        saturated_share=share,
        times_too_bright=over,
        brighter_level=level,
        focus_contrast=focus,
        lit_share=float(sight.lit.mean()),
        proposed_exposures_s=proposal,
        exposures_s=list(exposures),
    )


def _dark(lit: int, level: float, exposures: Sequence[float], told: str) -> str:
    """Say that it is too dark, by how much, and what to do."""
    longest = f"at the longest exposure, {exposures[-1]:.3g} s"
    if lit < LEAST_LIT:
        return (
            f"Too dark: {longest}, the projector's white shows nothing above the noise. Is the "
            "lamp on, the lens cap off, does the camera see what the projector lights? Then take "
            "much longer exposures, or open the aperture."
        )
    return (
        f"Too dark: {longest}, white reaches {level:.1%} of full scale where it is bright; "
        f"{LEAST_LEVEL:.0%} or more are wanted, {LEAST_LEVEL / level:.2g} times as much. Take "
        f"longer exposures, as sensor.exposures: [{told}], or open the aperture."
    )


def _veil(white: Double, lit: Mask) -> float | None:
    """Return the light well beyond the projector's outline over the picture's mean."""
    from scipy.ndimage import distance_transform_edt

    beyond = distance_transform_edt(~lit) > max(4.0, 0.03 * max(lit.shape))
    if beyond.sum() < LEAST_LIT or not lit.any() or not white.mean() > 0:
        return None
    return max(float(np.median(white[beyond]) / white.mean()), 0.0)


def _leaving(lit: Mask) -> str:
    """Say at which sides the projector's picture leaves the camera's."""
    sides = {
        "upper": lit[0], "lower": lit[-1], "left": lit[:, 0], "right": lit[:, -1],
    }  # fmt: skip
    left = [name for name, edge in sides.items() if edge.mean() > 0.1]
    if not left:
        return ""
    return f" It leaves the camera's view at the {', '.join(left)} edge."


def _grey(frames: NDArray[np.uint16]) -> Double:
    """Return frames (E, H, W) of those with channels, by their mean."""
    return np.asarray(frames if frames.ndim == 3 else frames.mean(axis=-1), np.float64)


def _full(frames: NDArray[np.uint16], white_level: int) -> Mask:
    """Return where any channel of frames (E, H, W) is saturated."""
    full = frames >= SATURATED * white_level
    return np.asarray(full if full.ndim == 3 else full.any(axis=-1))


def _at(images: Double, exposure: NDArray[np.intp]) -> Double:
    """Return of each pixel that of images (E, H, W) which an index (H, W) chooses."""
    return np.asarray(np.take_along_axis(images, exposure[None], 0)[0])


def _modulations(stripes: Double, both: Double, best: NDArray[np.intp]) -> Double:
    """Return amplitudes of the stripes, (3, H, W), in counts of each pixel's best exposure.

    With the picture and its inverse, white less it, each of two phases gives a difference; for
    perfectly sharp stripes both differences are the full signal.
    """
    return np.stack(
        [
            sum(np.abs(_at(2 * stripes[2 * k + quarter] - both, best)) for quarter in (0, 1)) / 2
            for k in range(3)
        ]
    )


def _filled(lit: Mask) -> Mask:
    """Close what is missing inside, as in dark strokes, and leave out what stands alone."""
    from scipy.ndimage import binary_closing, binary_fill_holes, binary_opening

    square = np.ones((3, 3), bool)
    padded = np.pad(lit, 2, mode="edge")
    closed = binary_closing(padded, square)[2:-2, 2:-2]
    return np.asarray(binary_opening(binary_fill_holes(closed), square))


def _extrapolated(
    rates: Double,
    dim: Double,
    dim_full: Mask,
    full: Mask,
    times: Double,
    noise: Double,
) -> Double:
    """Return rates of saturated pixels, from the brightest dimmer picture that isn't saturated.

    What a code gives of the next one's light is measured where both are known, else a usual gamma.
    """
    found = np.where(full, np.inf, rates)
    known, of_white, code_above = np.where(full, np.nan, rates), 1.0, 255
    for code, images, is_full in zip(DIM_CODES[::-1], dim[::-1], dim_full[::-1], strict=True):
        best = np.maximum((~is_full).sum(axis=0) - 1, 0)
        own = np.where(is_full[0], np.nan, _at(images / times[:, None, None], best))
        both = np.isfinite(known) & np.isfinite(own) & (known > 10 * noise[-1] / times[-1])
        ratio = (
            float(np.median(own[both] / known[both]))
            if both.sum() >= LEAST_LIT
            else (code / code_above) ** USUAL_GAMMA
        )
        of_white *= max(ratio, 1e-6)
        found = np.where(np.isinf(found) & np.isfinite(own), own / of_white, found)
        known, code_above = own, code
    brightest = float(found[np.isfinite(found)].max(initial=0.0))
    ceiling = max(brightest, float(rates.max(initial=0.0)) / of_white)
    return np.asarray(np.where(np.isinf(found), ceiling, found))
