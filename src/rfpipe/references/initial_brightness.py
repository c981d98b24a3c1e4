"""Brightness of the lamp while an acquisition's first brackets are taken.

    g[k] = L[k] / L[0],    L[k] = sum of bracket k's radiance over the known pixels

====== ============= ====== ====================================================================
symbol code          shape  meaning
====== ============= ====== ====================================================================
L      total         (C,)   light of a white bracket
L[0]   reference     (C,)   light of level 0's picture, with which looks at the rig begin
g      whites        (C,)   brightness of the white brackets, on average
g      randoms       (n, C) brightness at each random pattern, between them and level 0
====== ============= ====== ====================================================================

Most methods have level 0's picture taken under white light, too; otherwise the last white brackets
are the reference.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.sensor import Merged
from rfpipe.references.reference_images import Merger
from rfpipe.references.steadiness import smooth_changes
from rfpipe.rigs.faults import SIGNIFICANCE
from rfpipe.storage.files import LAMP, REFERENCE_BRACKETS, SYMMETRY, AcquisitionFolder

Double = NDArray[np.float64]

_LAST = 8  # white brackets that have the brightness at the end of the reference brackets

_log = logging.getLogger(__name__)


class Lamp(NamedTuple):
    """Brightness relative to that at the first look.

    Attributes
    ----------
    whites : ndarray of float64, shape (C,)
        Mean of the white brackets'.
    randoms : ndarray of float64, shape (n, C)
        At each random pattern.
    is_steady : bool
        Whether it drifts at most; otherwise brightness is 1 throughout.
    """

    whites: Double
    randoms: Double
    is_steady: bool

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest."""
        return {LAMP: {"whites": self.whites.tolist(), "steady": self.is_steady}}


class _Light(NamedTuple):
    """Sum over an image's known pixels, and its variance; (C,) each."""

    total: Double
    variance: Double


def measure_lamp(folder: AcquisitionFolder, merger: Merger, *, level_0_is_white: bool) -> Lamp:
    """Compare the brightness of the first brackets; log a change."""
    captured = folder.read_manifest(0, "capture")
    off, on = (captured[REFERENCE_BRACKETS][name] for name in ("black_frames", "floodlit_frames"))
    count = captured.get(SYMMETRY, {}).get("symmetry_frames", 0)
    channels = merger.floodlit.shape[-1]
    steady = np.ones(channels), np.ones((count, channels))
    last = range(off + max(0, on - _LAST), off + on)
    with folder.frames(0, "capture", REFERENCE_BRACKETS) as frames:
        whites = [_light(merger.merge(frames.read(index, index + 1), index)) for index in last]
    now = _level_0(folder, merger) if level_0_is_white else None
    series = np.stack([one.total for one in (*whites, *([now] if now else []))])
    over = series[-1]
    if not (over > 0).all():
        return Lamp(*steady, is_steady=True)
    if not smooth_changes(series / over):
        return Lamp(*steady, is_steady=False)
    before = _Light(*(np.mean([one[part] for one in whites], axis=0) for part in (0, 1)))
    before = before._replace(variance=before.variance / len(whites))
    mean = _light(Merged(merger.floodlit[None], merger.floodlit_variance[None], 0))
    reference = now or before
    at_end, at_mean = (_ratio(one, reference) for one in (before, mean))
    times, ends = np.arange(count), (-(len(whites) + 1) / 2, float(count))
    randoms = [np.interp(times, ends, (one, 1.0)) for one in at_end]
    change = float(np.abs(at_mean - 1).max())
    if change:
        _log.warning(
            "the lamp's light changed by %.2g %% from the white pictures to level 0; it is "
            "divided out", 100 * change,
        )  # fmt: skip
    return Lamp(at_mean, np.reshape(np.stack(randoms, axis=1), (count, channels)), is_steady=True)


def with_brightness(merger: Merger, whites: Double) -> Merger:
    """Return a merger whose floodlit image has the brightness of the first look."""
    if (whites == 1).all():
        return merger
    factor = (1 / whites).astype(np.float32)
    return replace(
        merger,
        floodlit=merger.floodlit * factor,
        floodlit_variance=merger.floodlit_variance * factor**2,
    )


def _level_0(folder: AcquisitionFolder, merger: Merger) -> _Light:
    """Light of level 0's picture."""
    with folder.frames(0, "capture") as frames:
        return _light(merger.merge(frames.read(0, 1), 0))


def _light(merged: Merged) -> _Light:
    known = np.isfinite(merged.variance[0])
    parts = (np.where(known, image[0], 0) for image in (merged.radiance, merged.variance))
    return _Light(
        *(part.reshape(-1, part.shape[-1]).sum(axis=0, dtype=np.float64) for part in parts)
    )


def _ratio(light: _Light, reference: _Light) -> Double:
    """Brightness relative to the reference's, (C,); 1 where the difference may be noise."""
    ratio = light.total / reference.total
    noise = np.sqrt(light.variance + ratio**2 * reference.variance) / reference.total
    return np.where(np.abs(ratio - 1) > SIGNIFICANCE * noise, ratio, 1.0)
