"""Symmetric photography's pictures on physically based scenes [thesis Fig. 5.6, 5.7, 5.11]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.evaluating.studies.physical import (
    Arrays,
    Rows,
    acquired,
    cost,
    physical_scene,
    white,
)

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe_mitsuba.scene import MitsubaScene

__all__ = ["bears_study", "flare_study"]

Float = NDArray[np.float32]

_LETTERS = ("EG", "SR")
_FLARE = 0.03  # of a pixel's light, that the aperture spreads over a star
_ARMS = 6
_TIGHT, _LOOSE = 1e-4, 3e-3


def letters(side: int) -> Float:
    """Return bright letters in the middle of a dark picture (side, side)."""
    from rfpipe_mitsuba.worlds.textures import lettering

    dots = lettering(_LETTERS, ink=(1, 1, 1), paper=(0, 0, 0), fine=1)[..., 0]
    rows, columns = dots.shape
    height = rows * (side // rows) or side
    width = max(1, columns * height // rows)
    drawn = dots[np.arange(height) * rows // height][:, np.arange(width) * columns // width]
    picture = np.zeros((side, side), np.float32)
    top, left = max(0, (side - height) // 2 - side // 16), (side - width) // 2  # on the sweets
    picture[top : top + height, left : left + width] = drawn
    return picture


def bears_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire translucent sweets by two coaxial pairs 120 degrees apart [Fig. 5.6, 5.7].

    Returns
    -------
    rows : list of dict
        A row of Table 5.1, ``letters_error`` and ``both_error``: relative RMS errors of the
        picture from the front by the letters, and by them and the second pair's even light; and
        ``levels``: by level, patterns shown up to there and the error of the letters' picture.
    arrays : dict of ndarray
        Float32 (H, W, 3): ``letters``, ``both``, ``{name}_truth`` and ``level_{k}``.
    """
    scene = physical_scene(config, "sweets")
    result, _ = acquired(config, scene, "symmetric")
    front = np.zeros(scene.projector_shape, np.float32)
    front[0] = letters(front.shape[-1])
    both = front.copy()
    both[1] = 1
    arrays: Arrays = {"pattern": front[0]}
    for name, pattern in (("letters", front), ("both", both)):
        arrays[name] = result.transport.relight(pattern)[0]
        arrays[f"{name}_truth"] = _seen(scene, pattern)
    shown, levels = 0, []
    for row in result.levels.to_dict("records"):
        level = int(row["level"])
        shown += int(row["patterns"])
        picture = result.transport.truncate(level).relight(front)[0]
        arrays[f"level_{level}"] = picture
        error = relative_rms(picture, arrays["letters_truth"])
        levels.append({"level": level, "patterns": shown, "error": error})
    errors = {
        f"{name}_error": relative_rms(arrays[name], arrays[f"{name}_truth"])
        for name in ("letters", "both")
    }
    images = arrays["both"], arrays["both_truth"]
    more: dict[str, Any] = {**errors, "levels": levels, "method": "symmetric"}
    return [cost("5.1", "Fig. 5.6, gummy bears", scene, result, images, **more)], arrays


def _seen(scene: MitsubaScene, pattern: Float) -> Float:
    """Return the true picture from the first camera."""
    shape = (*scene.camera_shape, scene.channels)
    picture: Float = scene.apply(pattern[None])[0].reshape(shape)
    first: Float = picture.reshape(-1, *shape[-3:])[0]
    return first


class _Flared:
    """A scene whose camera, unlike its projector, spreads some light over a star."""

    def __init__(self, scene: MitsubaScene) -> None:
        self._scene = scene
        self.camera_shape, self.projector_shape = scene.camera_shape, scene.projector_shape
        self.channels = scene.channels
        self._star = _star(scene.camera_shape[-1])

    def apply(self, patterns: NDArray[np.float32]) -> Float:
        """Radiance (B, M, C) under patterns (B, N), with the flare."""
        from scipy.signal import fftconvolve

        images = self._scene.apply(patterns)
        shaped = images.reshape(len(images), *self.camera_shape, self.channels).astype(np.float64)
        spread = fftconvolve(shaped, self._star[None, :, :, None], mode="same", axes=(1, 2))
        flared = np.maximum((1 - _FLARE) * shaped + _FLARE * spread, 0)
        return flared.reshape(images.shape).astype(np.float32)


def _star(side: int) -> NDArray[np.float64]:
    """Return a star of rays from the middle, falling off with the distance, its sum 1."""
    reach = side // 2
    rows, columns = np.indices((2 * reach + 1, 2 * reach + 1)) - reach
    distance = np.hypot(rows, columns)
    star = np.zeros(distance.shape)
    for arm in range(_ARMS // 2):
        turn = np.pi * (arm / (_ARMS / 2) + 1 / 12)
        off = np.abs(rows * np.cos(turn) - columns * np.sin(turn))
        star += np.clip(1 - off, 0, 1)
    star = np.where(distance > 0, star / np.maximum(distance, 1), 0)
    star[distance > reach] = 0
    total: NDArray[np.float64] = star / star.sum()
    return total


def flare_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire highlights through a camera whose lens flares, tight and loose [Fig. 5.11].

    Returns
    -------
    rows : list of dict
        ``case`` ("tight", "loose", "without": no flare, at the tight tolerance), ``tolerance``,
        ``patterns``, ``error`` of the lit picture, and ``around``: that around its highlights.
    arrays : dict of ndarray
        Float32 (H, W, 3): ``truth`` without flare, ``flared``, ``tight``, ``loose``, ``without``.
    """
    scene = physical_scene(config, "glossy_metal")
    flared = _Flared(scene)
    pattern = white(scene.projector_shape)
    pattern[:, : pattern.shape[1] // 2] = 0
    shape = (*scene.camera_shape, scene.channels)
    arrays: Arrays = {"truth": _seen(scene, pattern)}
    arrays["flared"] = flared.apply(pattern.reshape(1, -1))[0].reshape(shape)
    brightest = arrays["flared"].max(axis=-1)
    around = _grown(brightest > np.percentile(brightest, 97))
    rows: Rows = []
    for case, before, tolerance in (
        ("tight", flared, _TIGHT),
        ("loose", flared, _LOOSE),
        ("without", scene, _TIGHT),
    ):
        result, _ = acquired(config, before, "symmetric", tolerance=tolerance)
        relit = result.transport.relight(pattern)
        truth = arrays["truth" if case == "without" else "flared"]
        arrays[case] = relit
        rows.append(
            {
                "case": case,
                "tolerance": tolerance,
                "patterns": result.patterns,
                "error": relative_rms(relit, truth),
                "around": relative_rms(relit, truth, around),
            }
        )
    return rows, arrays


def _grown(spots: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return spots, and what lies around them, two pixels wide."""
    from scipy.ndimage import binary_dilation

    grown: NDArray[np.bool_] = binary_dilation(spots, iterations=2)
    return grown
