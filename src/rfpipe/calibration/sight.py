"""What the camera sees: the projector's outline, what is saturated or too dark, how sharp it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.black import LONGEST_SECONDS, bearable_seconds
from rfpipe.calibration.verdicts import Findings
from rfpipe.pictures.images import srgb
from rfpipe.units import SATURATION_FRACTION

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Mask = NDArray[np.bool_]

_AIM = 0.75  # fraction of full scale of the brightest pixels at the shortest exposure
_SURE = 5.0  # standard deviations of light
_REPEATS = 2
_DARKER = 8  # proposed exposures than ones that saturate, whose light is not known
_FEW = 25  # pixels

RED, BLUE, YELLOW = (0.9, 0.1, 0.1), (0.15, 0.3, 0.95), (1.0, 0.82, 0.12)


def sight_pictures(shape: tuple[int, int], period: int) -> list[Float]:
    """Return off and white pictures; stripes: fine ones along x and y, and wide ones.

    All are of codes 0 and 255: the projector's response isn't known yet.
    """
    pictures = [np.broadcast_to(np.float32(n // _REPEATS), shape) for n in range(2 * _REPEATS)]
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
    stripes = frames[2 * _REPEATS :]
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
    rates = at_best(signal / times)
    rates[white_full[0]] = max(rates.max(), white_level / exposures[0])  # at least
    # the brightest half per cent are glints
    is_few = bool(lit.sum() < _FEW)
    of_lit = rates.ravel() if is_few else rates[lit]
    brightest, brighter = np.maximum(np.percentile(of_lit, (99.5, 90)), 0)
    # a saturated frame is of the least light that it may be
    last = max(
        (k for k in range(1, len(off_full)) if k == 1 or off_full[k].mean() < 0.5), default=0
    )
    low, high = black[0].mean(), black[last].mean()
    rate = max(float(high - low), 0.0) / max(exposures[last] - exposures[0], 1e-9)
    level = min(float(low) - rate * exposures[0], white_level / 2)
    bearable = bearable_seconds(white_level - level, rate)
    share = float(saturated.sum() / max(lit.sum(), 1))
    # as many exposures, as far apart, the brightest pixels just below saturation in the shortest
    fitting = _AIM * (white_level - level) / brightest if brightest > 0 else exposures[0]
    wanted = exposures[-1] * (1 / _DARKER if share > 0.01 else fitting / exposures[0])
    longer = min(wanted, bearable) / exposures[-1]
    reached = float(brighter * exposures[-1] / (white_level - level))
    seen = (signal > _SURE * noise[:, None, None]) & ~off_full
    sides = {"upper": lit[0], "lower": lit[-1], "left": lit[:, 0], "right": lit[:, -1]}
    edges = [name for name, side in sides.items() if side.mean() > 0.1]
    is_black = off_full[0].mean() <= 0.01
    facts = {
        "lit_share": float(lit.mean()),
        "edges_left": len(edges),
        "edges": ", ".join(edges),
        "bearable_s": bearable,
        "wanted_s": min(wanted, LONGEST_SECONDS),
        "shortest_s": exposures[0],
        "longest_s": exposures[-1],
        "longer_times": longer,
        "less_noise": float(np.sqrt(longer)),
        "proposed_exposures_s": [float(f"{one * longer:.2g}") for one in exposures],
        "stripes_pixels": period,
        "focus_contrast": float(np.nanmedian(focus)) if np.isfinite(focus).any() else None,
        "black_level": level,
        "saturated_share": share,
        "black_saturated_share": float(off_full[0].mean()),
        "overexposed_share": share if is_black else None,
        "brighter_level": reached if is_black and not is_few else None,
        "is_stripeless": int(is_black and is_few),
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


def sight_picture(white: NDArray[Any], saturated: Mask, dark: Mask, lit: Mask) -> Double:
    """Return the scene as RGB in [0, 1]: what is saturated in red, what is too dark in blue.

    The brightest half per cent of the light are white. Around what is lit lies a yellow outline.
    """
    from scipy.ndimage import binary_dilation

    light = np.maximum(white, 0)
    picture = np.array(srgb(light[..., None], float(np.percentile(light, 99.5)) or 1.0))
    picture[saturated], picture[dark] = RED, BLUE
    picture[binary_dilation(lit, np.ones((3, 3), bool)) & ~lit] = YELLOW
    return picture


def _filled(lit: Mask) -> Mask:
    """Close what is missing inside, as in dark strokes, and leave out what stands alone."""
    from scipy.ndimage import binary_closing, binary_fill_holes, binary_opening

    square = np.ones((3, 3), bool)
    closed = binary_closing(np.pad(lit, 2, mode="edge"), square)[2:-2, 2:-2]
    return np.asarray(binary_opening(binary_fill_holes(closed), square))
