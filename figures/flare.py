"""Fig. 5.11: highlights through a camera whose lens flares, at a tight and a loose tolerance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from figures.common import (
    Items,
    Picture,
    Size,
    Table,
    acquired,
    error,
    exposure,
    percent,
    physical,
    seen,
    size_of,
    white,
)
from rfpipe.array_types import Float
from rfpipe.report.drawing import Panel, difference, draw

_FLARE = 0.03  # of a pixel's light, that the aperture spreads over a star
_ARMS = 6
_TIGHT, _LOOSE = 3e-3, 1e-2  # tighter still, noise hides more light than flare moves
_HIGHLIGHTS = 97.0  # percentile of brightness


class _Flared:
    """A scene whose camera, unlike its projector, spreads some light over a star."""

    def __init__(self, scene: Any) -> None:
        self.scene = scene
        self._star = _star(scene.camera_shape[-1])

    def __getattr__(self, name: str) -> Any:
        return getattr(self.scene, name)

    def apply(self, patterns: NDArray[np.float32]) -> Float:
        """Radiance (B, M, C) under patterns (B, N), with the flare."""
        from scipy.signal import fftconvolve

        images = self.scene.apply(patterns)
        shape = (len(images), *self.scene.camera_shape, self.scene.channels)
        shaped = images.reshape(shape).astype(np.float64)
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
    star = np.where((distance > 0) & (distance <= reach), star / np.maximum(distance, 1), 0)
    total: NDArray[np.float64] = star / star.sum()
    return total


def items(size: Size) -> Items:
    """Acquire gloss and rough metal in a box, its right half lit afterwards."""
    from scipy.ndimage import binary_dilation

    scene = physical(size, "glossy_metal")
    flared = _Flared(scene)
    pattern = white(scene.projector_shape)
    pattern[:, : pattern.shape[1] // 2] = 0
    brightest = seen(flared, pattern).max(axis=-1)
    spots = brightest > np.percentile(brightest, _HIGHLIGHTS)
    around = binary_dilation(spots, iterations=2)
    bright = exposure(seen(scene, pattern))
    panels, rows = [], []
    for case, before, tolerance in (
        ("tight threshold", flared, _TIGHT),
        ("loose threshold", flared, _LOOSE),
        ("no flare, tight threshold", scene, _TIGHT),
        ("no flare, loose threshold", scene, _LOOSE),
    ):
        result, _ = acquired(before, "symmetric", tolerance=tolerance)
        relit, truth = result.transport.relight(pattern), seen(before, pattern)
        off, at_highlights = error(relit, truth), error(relit, truth, around)
        rows.append((case, tolerance, result.patterns, off, at_highlights))
        below = f"{result.patterns} patterns, error {percent(off)}"
        panels.append(
            [
                Panel(truth, "the camera's view", "", bright),
                Panel(relit, f"relit: {case}", below, bright),
                difference(relit, truth, bright),
            ]
        )
    summary = ", ".join(f"{case} {percent(at_highlights)}" for case, *_, at_highlights in rows)
    caption = (
        f"Errors at the highlights: {summary}. The camera's aperture spreads 3 % of each pixel's "
        "light over a star of six arms; the projector has no flare, so that the matrix isn't "
        f"symmetric. {size_of(scene)}"
    )
    thesis = (
        "lens flare in the camera alone breaks the symmetry: a tight threshold corrupts the "
        "highlights, a loose one makes that less noticeable."
    )
    yield Picture("fig_5_11", "Fig. 5.11", thesis, caption, draw(panels))
    caption = "Relative RMS error of the half-lit picture against the camera's view."
    columns = ["case", "tolerance", "patterns", "error", "at_highlights"]
    yield Table("flare", "Tight against loose", caption, pd.DataFrame(rows, columns=columns))
