"""Drift watch: the floodlit image again and again during a capture, and what it changed by.

A lamp ages, warms up and flickers, and a night-long capture sees it. The normalization of a level
[B.2] takes out what changes between levels; the watch finds what changes within one.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError

if TYPE_CHECKING:
    from rfpipe.stages.merging.merger import Merger
    from rfpipe.store import FrameStore

__all__ = ["DRIFT", "Drift", "item_count", "item_due", "look", "measure", "positions"]

Double = NDArray[np.float64]

DRIFT = "drift"
"""The repeated floodlit brackets of a level: their store and their key in manifests."""

# Cells, along either side of an image, whose change is looked at by itself.
_CELLS = 16
# Standard deviations from which on a change counts as one: among hundreds of cells, noise has 4.
_SIGNIFICANCE = 5.0

_log = logging.getLogger(__name__)


def item_count(patterns: int, every: int) -> int:
    """Return the looks at a level: one before each `every` patterns, and one after the last."""
    return -(-patterns // every) + 1


def item_due(position: int, patterns: int, every: int) -> int:
    """Return the look that must have been taken before the pattern at `position` is shown."""
    return item_count(patterns, every) - 1 if position == patterns else position // every


def positions(patterns: int, every: int) -> Double:
    """Return before which pattern each look was taken."""
    return np.minimum(np.arange(item_count(patterns, every)) * every, patterns).astype(np.float64)


@dataclass(frozen=True)
class Drift:
    """The brightness of the repeated floodlit images.

    Attributes
    ----------
    gain, deviation : ndarray of float64, shape (n, C)
        Light of each look, relative to the floodlit image of level 0, and its standard deviation.
    local : ndarray of float64, shape (n,)
        Largest significant change of a sixteenth by a sixteenth of the image beyond that of the
        whole, relative; 0 where none is.
    """

    gain: Double
    deviation: Double
    local: Double

    def gains_at(self, patterns: int, every: int) -> Double:
        """Return the relative brightness (patterns, C) at each pattern, between the looks."""
        at = np.arange(patterns) + 0.5
        known = positions(patterns, every)
        return np.stack([np.interp(at, known, of_channel) for of_channel in self.gain.T], axis=1)

    @property
    def change(self) -> float:
        """Largest difference of brightness between two looks, 0 where it is within the noise."""
        span = self.gain.max(axis=0) - self.gain.min(axis=0)
        noise = np.sqrt(2) * self.deviation.max(axis=0)
        return float(np.where(span > _SIGNIFICANCE * noise, span, 0).max(initial=0.0))

    def facts(self, every: int) -> dict[str, Any]:
        """Return plain data for a manifest."""
        return {
            "every": every,
            "gain": self.gain.tolist(),
            "deviation": self.deviation.tolist(),
            "local": self.local.tolist(),
        }

    def report(self, name: str, *, divided_out: bool) -> None:
        """Log what changed, and what to do about it."""
        noise = float(self.deviation.max(initial=0.0))
        local = float(self.local.max(initial=0.0))
        if not self.change and not local:
            _log.info(
                "%s: the light kept steady, to its noise of %.2g %%, in %d looks",
                name, 100 * noise, len(self.gain),
            )  # fmt: skip
            return
        advice = (
            "it is divided out" if divided_out else "merge.divide_out_drift would divide it out"
        )
        _log.warning(
            "%s: the light changed by %.2g %% (noise %.2g %%) in %d looks; %s. Parts of the image "
            "changed by up to %.2g %% more, which stays: check for stray light and for what moved",
            name, 100 * self.change, 100 * noise, len(self.gain), advice, 100 * local,
        )  # fmt: skip


def measure(merger: Merger, frames: FrameStore) -> Drift:
    """Compare looks with the floodlit image of level 0.

    Parameters
    ----------
    merger : Merger
        Calibrated.
    frames : FrameStore
        Their brackets, (n, E, ...).

    Raises
    ------
    CaptureError
        When no light comes back.
    """
    found = [look(merger, frames.read(n, n + 1), n) for n in range(frames.shape[0])]
    gain, deviation, local = (np.stack(part) for part in zip(*found, strict=True))
    return Drift(gain, deviation, local)


def look(merger: Merger, bracket: NDArray[Any], index: int) -> tuple[Double, Double, Double]:
    """Return gain, deviation (C,) and local change () of one look's bracket (1, E, ...)."""
    merged = merger.merge(bracket, index)
    cells = [
        _cells(image)
        for image in (
            merged.radiance[0], merged.variance[0], merger.floodlit, merger.floodlit_variance,
        )
    ]  # fmt: skip
    seen, seen_variance, known, known_variance = cells
    total = known.sum(axis=0)
    if not (total > 0).all():
        raise CaptureError(
            "the floodlit image has a channel without light, so that drift can't be watched: set "
            "capture.drift_minutes to null"
        )
    gain = seen.sum(axis=0) / total
    variance = seen_variance.sum(axis=0) + gain**2 * known_variance.sum(axis=0)
    expected = known * gain
    noise = np.sqrt(seen_variance + gain**2 * known_variance)
    significant = np.abs(seen - expected) > _SIGNIFICANCE * noise
    change = np.divide(
        np.abs(seen - expected), expected, out=np.zeros_like(seen), where=expected > 0
    )
    local = np.where(significant, change, 0).max(initial=0.0)
    return gain, np.sqrt(variance) / total, np.asarray(local)


def _cells(image: NDArray[np.float32]) -> Double:
    """Sum an image (*camera_shape, C) over the cells of its views, ``(cells, C)``."""
    *shape, channels = image.shape
    planes = image.reshape(*RayDomain(tuple(shape)).stack_shape, channels).astype(np.float64)
    rows, columns = (
        np.arange(min(extent, _CELLS)) * extent // min(extent, _CELLS)
        for extent in planes.shape[1:3]
    )
    sums = np.add.reduceat(np.add.reduceat(planes, rows, axis=1), columns, axis=2)
    return sums.reshape(-1, channels)
