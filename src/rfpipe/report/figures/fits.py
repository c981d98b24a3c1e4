"""Lines fitted to patterns against levels."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["line_fit", "patterns_at"]


def line_fit(rows: Any) -> dict[str, float]:
    """Fit a line to patterns against levels, and a power law to patterns against pixels.

    Parameters
    ----------
    rows : DataFrame
        ``levels``, ``rays`` and ``patterns``, two rows at least.

    Returns
    -------
    dict of str to float
        ``slope`` and ``base`` of the line, ``explained``: its share of the variance, and
        ``exponent`` of the power law.
    """
    levels, patterns = (np.asarray(rows[name], float) for name in ("levels", "patterns"))
    slope, base = np.polyfit(levels, patterns, 1)
    left = patterns - base - slope * levels
    spread = float(((patterns - patterns.mean()) ** 2).sum())
    exponent, _ = np.polyfit(np.log(np.asarray(rows["rays"], float)), np.log(patterns), 1)
    explained = 1 - float((left**2).sum()) / spread if spread > 0 else 1.0
    return {
        "slope": float(slope),
        "base": float(base),
        "explained": explained,
        "exponent": float(exponent),
    }


def patterns_at(fit: dict[str, float], rays: int, measured: tuple[int, int]) -> tuple[float, float]:
    """Extrapolate to so many projector pixels, by the line and by the power law.

    `measured` are the pixels and the patterns of an acquisition; both curves go through it.
    """
    own_rays, own_patterns = measured
    further = np.log2(rays / own_rays) / 2
    line = own_patterns + fit["slope"] * further
    return float(line), float(own_patterns * (rays / own_rays) ** fit["exponent"])
