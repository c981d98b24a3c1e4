"""Whether the rig moved: one fine random pattern, shown again and again, and what it changed by.

Half a pixel between camera and projector changes every ray of it by half, where white light changes
at edges alone; a change of the lamp changes all rays alike, and is taken off.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, StoreError
from rfpipe.photometry.symmetry import random_signs
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.store import FrameStore

if TYPE_CHECKING:
    from rfpipe.photometry.sensor import Merged
    from rfpipe.rigs import Rig
    from rfpipe.stages.merging.merger import Merger

__all__ = ["MOVES", "Move", "compare", "every_of", "first_look", "measure", "move_pattern", "told"]

MOVES = "moves"
"""The repeated random pattern of a level: its store and its key in manifests."""

_SEED = 15
# A change of the picture, relative to its norm, that is worth a word: half a pixel makes fifty
# times as much, and a lamp that changes here and there a tenth.
_WORTH_A_WORD = 0.02
# What the noise itself is known to, as a share of its square.
_NOISE_KNOWN = 0.1
_SIGNIFICANCE = 5.0

_log = logging.getLogger(__name__)


LOOK_PATTERNS = 8
"""So that a rig that moved is noticed within ten patterns, at an eighth more of them."""


def every_of(looks: int | None, *, tells: bool) -> int:
    """Return the patterns from one look to the next, 0 for none.

    Parameters
    ----------
    looks : int or None
        As the settings say; None: `LOOK_PATTERNS`, where the patterns don't tell by themselves.
    tells : bool
        Whether they do, by reciprocity.
    """
    return (0 if tells else LOOK_PATTERNS) if looks is None else looks


@dataclass(frozen=True)
class Move:
    """How a look differs from the first one.

    Attributes
    ----------
    change : float
        Of the picture, relative to its norm, beyond brightness and noise; 0 where that is all.
    """

    change: float

    @property
    def is_wrong(self) -> bool:
        """Whether the rig, or the scene, moved."""
        return self.change > _WORTH_A_WORD


def move_pattern(rig: Rig) -> NDArray[np.float32]:
    """Return the pattern that is repeated: each ray lit or dark at random."""
    lit = random_signs(rig.projector_shape, 1, 1, seed=_SEED)[0] > 0
    return np.asarray(lit if lit.any() else ~lit, np.float32)


def first_look(folder: AcquisitionFolder, merger: Merger) -> Merged | None:
    """Return an acquisition's first look, merged; None where there is none yet."""
    stores: Iterable[Any] = sorted(folder.path.glob(f"L[0-9]*/{MOVES}.zarr"))
    for store in stores:
        try:
            with FrameStore.open(store) as frames:
                if frames.done[0]:
                    return merger.merge(frames.read(0, 1), 0)
        except StoreError:
            continue
    return None


def compare(merger: Merger, first: Merged, bracket: NDArray[Any]) -> Move:
    """Compare a look's bracket (1, E, ...) with the first look."""
    later = merger.merge(bracket, 0)
    known = np.isfinite(first.variance[0]) & np.isfinite(later.variance[0])
    was, now, v_was, v_now = (
        np.where(known, image[0], 0).reshape(-1, image.shape[-1]).astype(np.float64)
        for image in (first.radiance, later.radiance, first.variance, later.variance)
    )
    over = np.square(was).sum(axis=0)
    gain = np.where(over > 0, (was * now).sum(axis=0) / np.where(over > 0, over, 1), 1)
    noise = v_now + gain**2 * v_was
    light = float((np.square(gain * was)).sum() - (gain**2 * v_was).sum())
    if light <= 0:
        return Move(0.0)
    square = float(np.square(now - gain * was).sum() - noise.sum())
    chance = _SIGNIFICANCE * np.sqrt(2 * np.square(noise).sum()) + _NOISE_KNOWN * noise.sum()
    return Move(float(np.sqrt(max(square, 0.0) / light)) if square > chance else 0.0)


def measure(folder: AcquisitionFolder, merger: Merger, frames: FrameStore) -> dict[str, Any]:
    """Return plain data for a manifest: what each look (n, E, ...) of a level changed by."""
    first = first_look(folder, merger)
    looks = range(frames.shape[0])
    found = [compare(merger, first, frames.read(n, n + 1)) if first else Move(0.0) for n in looks]
    return {
        "change": [float(f"{move.change:.4g}") for move in found],
        "moved": any(move.is_wrong for move in found),
    }


def told(found: Move, where: str, *, refuse: bool) -> None:
    """Say where the rig moved.

    Raises
    ------
    CaptureError
        When it did, and `refuse`.
    """
    if not found.is_wrong:
        return
    text = (
        f"{where}: the rig or the scene moved: the same pattern looks different by "
        f"{found.change:.1%} from how it looked first, whatever the lamp does"
    )
    if refuse:
        raise CaptureError(
            f"{text}. What is captured is kept, but pictures from before and after don't fit "
            "together: put things back, or remove the acquisition's folder and begin anew; "
            "capture.watch: warn goes on regardless"
        )
    _log.warning("%s. Pictures from before and after don't fit together", text)
