"""The scene before the camera: outline of the projector's light, exposure, and sharpness."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double, Float
from rfpipe.calibration.dark import LONGEST_SECONDS, bearable_seconds
from rfpipe.calibration.verdicts import Findings
from rfpipe.pictures.images import srgb
from rfpipe.units import SATURATION_FRACTION

_TARGET_LEVEL = 0.75  # fraction of full scale of the brightest pixels at the shortest exposure
_SIGNIFICANCE = 5.0  # standard deviations beyond which light is significant
_REPEATS = 2  # brackets of black, and of white
_DARKENING = 8  # factor by which saturated exposures, whose light is unknown, are shortened
_LEAST_PIXELS = 25

RED, BLUE, YELLOW = (0.9, 0.1, 0.1), (0.15, 0.3, 0.95), (1.0, 0.82, 0.12)


def scene_patterns(shape: tuple[int, int], period: int) -> list[Float]:
    """Patterns of the step: black, white, fine stripes along x and y, and wide stripes along x.

    Stripes are shown in two phases, a quarter of a period apart. All patterns have the codes 0 and
    255 only, since the projector's response isn't known yet.
    """
    pictures = [np.broadcast_to(np.float32(n // _REPEATS), shape) for n in range(2 * _REPEATS)]
    # at least four stripes, so that flare, which depends on a picture's mean, is the same in all
    wide = max(2 * period, min(4 * period, shape[1] // 4))
    for axis, pixels in ((1, period), (0, period), (1, wide)):
        along = np.expand_dims(np.arange(shape[axis]) + 0.5, 1 - axis)
        for quarter in (0, 1):
            stripes = (along - quarter * pixels / 4) % pixels < pixels / 2
            pictures.append(np.broadcast_to(stripes.astype(np.float32), shape))
    return pictures


class _View(NamedTuple):
    """Mean counts under the patterns of the step, over exposures E and camera pixels.

    Attributes
    ----------
    black, white : ndarray of float64, shape (E, H, W)
    noise : ndarray of float64, shape (E,)
        Standard deviation of black.
    stripes : ndarray of float64, shape (6, E, H, W)
    black_saturated, saturated : ndarray of bool, shape (E, H, W)
        Pixels saturated in black, and in black or white.
    """

    black: Double
    white: Double
    noise: Double
    stripes: Double
    black_saturated: Bools
    saturated: Bools

    @property
    def signal(self) -> Double:
        """Counts of the projector's light, (E, H, W)."""
        return self.white - self.black


def measure_scene(
    brackets: Sequence[NDArray[np.uint16]],
    exposures: Sequence[float],
    white_level: int,
    period: int,
) -> Findings:
    """Measure outline, exposure and sharpness of the projector's light in the camera's picture.

    Parameters
    ----------
    brackets : sequence of ndarray of uint16, shape (E, H, W[, C])
        Brackets of `scene_patterns`.
    exposures : sequence of float
        Exposure times in seconds.
    white_level : int
        Full scale in counts.
    period : int
        Period of the fine stripes in projector pixels.

    Returns
    -------
    Findings
        Arrays (H, W): ``white``, counts per second of the projector's full light; ``black``, counts
        of the all-off picture at the longest exposure; ``lit``, pixels that receive the projector's
        light directly; ``saturated`` and ``dark``, lit pixels that are saturated or dark at all
        exposures; ``focus``, contrast of fine stripes relative to wide ones, NaN where not lit.
    """
    view = _view(brackets, white_level)
    signal, times = view.signal, np.reshape(exposures, (-1, 1, 1)).astype(float)
    # of each pixel, the longest exposure that is not saturated
    best = np.maximum((~view.saturated).sum(axis=0) - 1, 0)[None]

    def at_best(images: Double) -> Double:
        return np.asarray(np.take_along_axis(images, best, 0)[0])

    # stripes and their inverse, which is white + black - stripes, each in two phases
    total = view.white + view.black
    amplitudes = [np.abs(at_best(2 * picture - total)) / 2 for picture in view.stripes]
    fine_x, fine_y, wide = (a + b for a, b in zip(amplitudes[::2], amplitudes[1::2], strict=True))
    modulated = wide > 2 * _SIGNIFICANCE * view.noise[best[0]]
    lit = _filled(modulated & (wide > 0.4 * at_best(signal)))  # scattered light has less contrast
    fine = np.minimum(fine_x, fine_y)
    focus = np.divide(fine, wide, out=np.full(wide.shape, np.nan), where=lit & modulated)
    rates = at_best(signal / times)
    # a lower bound for saturated pixels
    rates[view.saturated[0]] = max(rates.max(), white_level / exposures[0])
    visible = (signal > _SIGNIFICANCE * view.noise[:, None, None]) & ~view.black_saturated
    arrays = {
        "white": rates.astype(np.float32),
        "black": view.black[-1].astype(np.float32),
        "lit": lit,
        "saturated": lit & view.saturated[0],
        "dark": lit & ~visible.any(axis=0),
        "focus": np.clip(focus, 0, 1).astype(np.float32),
    }
    facts = {
        **_outline(lit),
        **_exposure_facts(view, rates, lit, exposures, white_level),
        "stripes_pixels": period,
        "focus_contrast": float(np.nanmedian(focus)) if np.isfinite(focus).any() else None,
    }
    return Findings.of("scene", facts, arrays)


def _view(brackets: Sequence[NDArray[np.uint16]], white_level: int) -> _View:
    """Average repetitions and channels of the step's brackets."""
    counts = np.stack(brackets)
    counts = counts.reshape(*counts.shape[:4], -1)
    frames = counts.mean(axis=-1)
    full: Bools = np.asarray((counts >= SATURATION_FRACTION * white_level).any(axis=-1))
    off, on = frames[:_REPEATS], frames[_REPEATS : 2 * _REPEATS]
    return _View(
        off.mean(axis=0),
        on.mean(axis=0),
        np.sqrt(np.square(off[0] - off[1]).mean(axis=(1, 2)) / 2 + 1 / 12),
        frames[2 * _REPEATS :],
        np.asarray(full[:_REPEATS].any(axis=0)),
        np.asarray(full[: 2 * _REPEATS].any(axis=0)),
    )


def _outline(lit: Bools) -> dict[str, Any]:
    """Size of the lit area, and the edges of the camera's picture that it crosses."""
    sides = {"upper": lit[0], "lower": lit[-1], "left": lit[:, 0], "right": lit[:, -1]}
    edges = [name for name, side in sides.items() if side.mean() > 0.1]
    return {
        "lit_share": float(lit.mean()),
        "edges_left": len(edges),
        "edges": ", ".join(edges),
    }


def _exposure_facts(
    view: _View, rates: Double, lit: Bools, exposures: Sequence[float], white_level: int
) -> dict[str, Any]:
    """Judge and propose exposures, by light `rates` (H, W) in counts per second."""
    is_small = bool(lit.sum() < _LEAST_PIXELS)
    # glints are excluded: the brightest 0.5 %
    brightest, brighter = np.maximum(
        np.percentile(rates.ravel() if is_small else rates[lit], (99.5, 90)), 0
    )
    level, rate = _black_line(view, exposures, white_level)
    span = white_level - level
    bearable = bearable_seconds(span, rate)
    saturated_share = float((lit & view.saturated[0]).sum() / max(lit.sum(), 1))
    # the same number and ratios of exposures, the brightest pixels just below saturation in the
    # shortest one
    if saturated_share > 0.01:
        desired = exposures[-1] / _DARKENING
    else:
        shortest = _TARGET_LEVEL * span / brightest if brightest > 0 else exposures[0]
        desired = exposures[-1] * (shortest / exposures[0])
    factor = min(desired, bearable) / exposures[-1]
    black_share = float(view.black_saturated[0].mean())
    is_black = black_share <= 0.01
    reached = float(brighter * exposures[-1] / span)
    return {
        "bearable_s": bearable,
        "wanted_s": min(desired, LONGEST_SECONDS),
        "shortest_s": exposures[0],
        "longest_s": exposures[-1],
        "longer_times": factor,
        "less_noise": float(np.sqrt(factor)),
        "proposed_exposures_s": [float(f"{seconds * factor:.2g}") for seconds in exposures],
        "black_level": level,
        "saturated_share": saturated_share,
        "black_saturated_share": black_share,
        "overexposed_share": saturated_share if is_black else None,
        "brighter_level": reached if is_black and not is_small else None,
        "is_stripeless": int(is_black and is_small),
    }


def _black_line(view: _View, exposures: Sequence[float], white_level: int) -> tuple[float, float]:
    """Black level in counts, and light of the all-off picture in counts per second.

    They are taken from the shortest exposure and the longest one that is mostly unsaturated; a
    saturated frame gives a lower bound.
    """
    share = view.black_saturated.mean(axis=(1, 2))
    last = max((k for k in range(1, len(share)) if k == 1 or share[k] < 0.5), default=0)
    low, high = view.black[0].mean(), view.black[last].mean()
    rate = max(float(high - low), 0.0) / max(exposures[last] - exposures[0], 1e-9)
    return min(float(low) - rate * exposures[0], white_level / 2), rate


def scene_image(white: NDArray[Any], saturated: Bools, dark: Bools, lit: Bools) -> Double:
    """Render the scene as RGB in [0, 1]: saturated pixels red, dark ones blue, outline yellow.

    The brightest 0.5 % of the pixels are white.
    """
    from scipy.ndimage import binary_dilation

    light = np.maximum(white, 0)
    picture = np.array(srgb(light[..., None], float(np.percentile(light, 99.5)) or 1.0))
    picture[saturated], picture[dark] = RED, BLUE
    picture[binary_dilation(lit, np.ones((3, 3), bool)) & ~lit] = YELLOW
    return picture


def _filled(lit: Bools) -> Bools:
    """Fill holes of a mask, such as dark lines, and remove single pixels."""
    from scipy.ndimage import binary_closing, binary_fill_holes, binary_opening

    square = np.ones((3, 3), bool)
    closed = binary_closing(np.pad(lit, 2, mode="edge"), square)[2:-2, 2:-2]
    return np.asarray(binary_opening(binary_fill_holes(closed), square))
