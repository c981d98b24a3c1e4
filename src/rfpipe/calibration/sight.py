"""What the camera sees: the projector's outline, what is saturated or too dark, how sharp it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.verdicts import Findings
from rfpipe.pictures.images import srgb
from rfpipe.units import SATURATION_FRACTION

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

_AIM = 0.75  # fraction of full scale of the brightest pixels at the shortest exposure
_SURE = 5.0  # standard deviations of light
_REPEATS = 2
_DIM_CODES = (16, 32, 64, 128)  # how much too bright is what white saturates
_USUAL_GAMMA = 2.2
_FEW = 25  # pixels

RED, BLUE, YELLOW = (0.9, 0.1, 0.1), (0.15, 0.3, 0.95), (1.0, 0.82, 0.12)


def sight_pictures(shape: tuple[int, int], period: int) -> list[Float]:
    """Return off, white and dimmer pictures; stripes: fine ones along x and y, and wide ones.

    All but the dimmer ones are of codes 0 and 255: the projector's response isn't known yet.
    """
    codes = (*[0] * _REPEATS, *[255] * _REPEATS, *_DIM_CODES)
    pictures = [np.broadcast_to(np.float32(code / 255), shape) for code in codes]
    # a few stripes at least, so that flare, which goes with a picture's mean, is the same in all
    wide = max(2 * period, min(4 * period, shape[1] // 4))
    for axis, pixels in ((1, period), (0, period), (1, wide)):
        along = np.expand_dims(np.arange(shape[axis]) + 0.5, 1 - axis)
        for quarter in (0, 1):
            stripes = (along - quarter * pixels / 4) % pixels < pixels / 2
            pictures.append(np.broadcast_to(stripes.astype(np.float32), shape))
    return pictures


def measure_sight(
    brackets: Sequence[NDArray[np.uint16]],
    exposures: Sequence[float],
    white_level: int,
    period: int,
) -> Findings:
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

    Returns
    -------
    Findings
        Arrays (H, W): ``white``, counts a second of the projector's full light; ``black``, counts
        of the all-off picture at the longest exposure; ``lit``, where the projector's own light
        falls; ``saturated`` and ``dark``, lit pixels that are so at all exposures; ``focus``,
        contrast of fine stripes over that of wide ones, NaN where not lit.
    """
    counts = np.stack(brackets)
    counts = counts.reshape(*counts.shape[:4], -1)
    frames = counts.mean(axis=-1)
    full: Mask = np.asarray((counts >= SATURATION_FRACTION * white_level).any(axis=-1))
    off, on = frames[:_REPEATS], frames[_REPEATS : 2 * _REPEATS]
    dim, stripes = np.split(frames[2 * _REPEATS :], [len(_DIM_CODES)])
    off_full: Mask = np.asarray(full[:_REPEATS].any(axis=0))
    white_full: Mask = np.asarray(full[: 2 * _REPEATS].any(axis=0))
    times, black = np.reshape(exposures, (-1, 1, 1)).astype(float), off.mean(axis=0)
    signal = on.mean(axis=0) - black
    # noise of darkness, and that of light where black is full of it
    noise = np.sqrt(np.square(off[0] - off[1]).mean(axis=(1, 2)) / 2 + 1 / 12)
    best = np.maximum((~white_full).sum(axis=0) - 1, 0)[None]  # the longest that isn't full

    def at_best(images: Double) -> Double:
        return np.asarray(np.take_along_axis(images, best, 0)[0])

    # of the stripes and their inverse, white less them, each in two phases
    both = on.mean(axis=0) + black
    amplitudes = [np.abs(at_best(2 * picture - both)) / 2 for picture in stripes]
    fine_x, fine_y, wide = (a + b for a, b in zip(amplitudes[::2], amplitudes[1::2], strict=True))
    above = wide > 2 * _SURE * noise[best[0]]
    lit = _filled(above & (wide > 0.4 * at_best(signal)))  # more contrast than what is scattered
    saturated = lit & white_full[0]
    fine = np.minimum(fine_x, fine_y)
    focus = np.divide(fine, wide, out=np.full(wide.shape, np.nan), where=lit & above)
    rates, unknown = at_best(signal / times), white_full[0].copy()
    of_white = 1.0
    # of what is saturated, by dimmer pictures, whose light is a share of white's
    for index, code in reversed(list(enumerate(_DIM_CODES))):
        light = (dim[index, 0] - black[0]) / exposures[0]
        is_known = ~full[2 * _REPEATS + index, 0]
        shared = is_known & ~unknown & (rates > 10 * noise[0] / exposures[0])
        of_white = (code / 255) ** _USUAL_GAMMA
        if shared.sum() >= _FEW:
            of_white = max(float(np.median(light[shared] / rates[shared])), 1e-6)
        rates[unknown & is_known] = light[unknown & is_known] / of_white
        unknown &= ~is_known
    rates[unknown] = max(rates.max(), white_level / exposures[0] / of_white)
    # the brightest half per cent are glints
    is_few = bool(lit.sum() < _FEW)
    of_lit = rates.ravel() if is_few else rates[lit]
    brightest, brighter = np.maximum(np.percentile(of_lit, (99.5, 90)), 0)
    middle = np.median(black, axis=(1, 2))
    last = max(int((middle < SATURATION_FRACTION * white_level).sum()) - 1, 0)
    glow = max((middle[last] - middle[0]) / (exposures[last] - exposures[0]), 0.0) if last else 0.0
    level = min(max(middle[0] - glow * exposures[0], 0.0), white_level / 2)
    seen = (signal > _SURE * noise[:, None, None]) & ~off_full
    facts = {
        **_outline(lit, rates),
        **_exposed(brightest, brighter, glow, white_level - level, exposures),
        "stripes_pixels": period,
        "focus_contrast": float(np.nanmedian(focus)) if np.isfinite(focus).any() else None,
        "black_level": float(level),
        "saturated_share": float(saturated.sum() / max(lit.sum(), 1)),
        "black_saturated_share": float(off_full[0].mean()),
    }
    is_black, is_dark = facts["black_saturated_share"] <= 0.01, facts["brighter_level"] < 0.1
    facts |= {
        "overexposed_share": facts["saturated_share"] if is_black else None,
        "brighter_level": facts["brighter_level"] if is_black and not is_few else None,
        "is_unlit": int(is_black and is_few and is_dark),
        "is_stripeless": int(is_black and is_few and not is_dark),
    }
    arrays = {
        "white": rates.astype(np.float32),
        "black": black[-1].astype(np.float32),
        "lit": lit,
        "saturated": saturated,
        "dark": lit & ~seen.any(axis=0),
        "focus": np.clip(focus, 0, 1).astype(np.float32),
    }
    return Findings.of("scene", facts, arrays)


def sight_picture(
    white: NDArray[Any], saturated: Mask, dark: Mask, outline_of: Mask | None = None
) -> Double:
    """Return the scene as RGB in [0, 1]: what is saturated in red, what is too dark in blue.

    The brightest half per cent of the light are white. An area may have its outline in yellow.
    """
    from scipy.ndimage import binary_dilation

    light = np.maximum(white, 0)
    picture = np.array(srgb(light[..., None], float(np.percentile(light, 99.5)) or 1.0))
    picture[saturated], picture[dark] = RED, BLUE
    if outline_of is not None:
        picture[binary_dilation(outline_of, np.ones((3, 3), bool)) & ~outline_of] = YELLOW
    return picture


def _outline(lit: Mask, rates: Double) -> dict[str, Any]:
    """Return the outline's share of the picture, light beyond it, and where it is cut."""
    from scipy.ndimage import distance_transform_edt

    beyond = distance_transform_edt(~lit) > max(4.0, 0.03 * max(lit.shape))
    has_veil = beyond.sum() >= _FEW and lit.any() and rates.mean() > 0
    sides = {"upper": lit[0], "lower": lit[-1], "left": lit[:, 0], "right": lit[:, -1]}
    left = [name for name, side in sides.items() if side.mean() > 0.1]
    return {
        "lit_share": float(lit.mean()),
        "veil": max(float(np.median(rates[beyond]) / rates.mean()), 0.0) if has_veil else None,
        "edges_left": len(left),
        "edges": ", ".join(left),
    }


def _exposed(
    brightest: float, brighter: float, glow: float, span: float, exposures: Sequence[float]
) -> dict[str, Any]:
    """Return how bright the lit pixels are (counts a second), and a bracket that suits them.

    It has as many exposures, as far apart, the brightest pixels just below saturation; none longer
    than a minute, nor than what the light of the all-off picture leaves room for.
    """
    proposed = list(exposures)
    if brightest > 0:
        first = _AIM * span / brightest
        longest = min(60.0, max(0.25 * span / glow, first) if glow > 0 else 60.0)
        scaled = [float(f"{one * first / exposures[0]:.2g}") for one in exposures]
        kept = [one for one in scaled if one <= 1.05 * longest]
        proposed = list(dict.fromkeys(kept or [float(f"{min(first, longest):.2g}")]))
    return {
        "shortest_s": exposures[0],
        "longest_s": exposures[-1],
        "times_too_bright": float(brightest * exposures[0] / (SATURATION_FRACTION * span)),
        "brighter_level": float(brighter * exposures[-1] / span),
        "proposed_exposures_s": proposed,
    }


def _filled(lit: Mask) -> Mask:
    """Close what is missing inside, as in dark strokes, and leave out what stands alone."""
    from scipy.ndimage import binary_closing, binary_fill_holes, binary_opening

    square = np.ones((3, 3), bool)
    closed = binary_closing(np.pad(lit, 2, mode="edge"), square)[2:-2, 2:-2]
    return np.asarray(binary_opening(binary_fill_holes(closed), square))
