"""Test of a rig for the coaxial one that a method takes it for, by a few random patterns.

For any two of them, and for the floodlit one, light from the one to where the other is lit must be
what goes back (reciprocity, 2.10). Half a pixel makes relit pictures wrong by 45 %.
"""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.symmetry import (
    CONFIDENCE,
    Pictures,
    measure_symmetry,
    random_signs,
)
from rfpipe.errors import CaptureError
from rfpipe.references.placement import placement_of
from rfpipe.references.reference_images import Merger
from rfpipe.storage.files import SYMMETRY, AcquisitionFolder

if TYPE_CHECKING:
    from rfpipe.methods import Method, Options

# Symmetric photography is off by one and a half times the error that is predicted; what is worth a
# word is a fifth of what is refused.
_WORTH_A_WORD = 0.2

# Squared error that a share of pixels which aren't known may seem to make, for that share: their
# light as it adds up in the floodlit image, and as much again in random ones, over 16 |T p|^2.
_MASKED = 0.5

# Excess of light that spoils pictures, and standard errors from which on it is significant.
_LEAST_EXCESS, _SURE = 0.01, 5.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Asymmetry:
    """Error of relit pictures, relative to their norm, if T were symmetric.

    The error is 0 where nothing but noise is seen. `place` describes a wrong place of the
    pictures on the rays, see `rfpipe.references.placement`. `excess` is the light of random
    pictures beyond that expected from the white ones, relative to the white; 0 unless it is
    significant. No asymmetry makes it: ``1^T (T - T^T) 1 = 0``.
    """

    error: float
    standard_error: float
    place: str = ""
    excess: float = 0.0

    @property
    def text(self) -> str:
        """Description of the error and its likely cause."""
        text = (
            f"taking the rig for a coaxial one makes an error of {self.error:.1%} +- "
            f"{self.standard_error:.1%} in relit pictures"
        )
        if self.excess:
            return (
                f"{text}, but random pictures have {self.excess:+.1%} of the white ones' light "
                "too much: the room's light changed (black it out), the rig or the scene moved, or "
                "the projector's light depends on its picture (switch dynamic contrast off)"
            )
        return f"{text}; {self.place}" if self.place else text

    @property
    def least(self) -> float:
        """Lower bound of the error, `CONFIDENCE` standard errors below it."""
        return self.error - CONFIDENCE * self.standard_error

    def judge(
        self,
        method: Method[Any],
        options: Options,
        accepted: float,
        *,
        aloud: bool = True,
        calibrated: bool = False,
    ) -> Method[Any]:
        """Return the method to go on with on a rig whose error is surely above `accepted`, or not.

        Where a method has the choice, it is less than `accepted` if its target is. `aloud` logs
        why; `calibrated` is whether a calibration found the rig coaxial. Raises CaptureError if the
        method needs a coaxial rig, and this is none.
        """
        found = f"light doesn't go from camera to projector as it comes: {self.text}"
        accepts = f"{accepted:.1%} are accepted (capture.asymmetry)"
        if method.needs_coaxial_rig and self.least > accepted:
            if self.excess:
                raise CaptureError(f"{found}, and {accepts}. Then begin anew")
            if calibrated:
                raise CaptureError(f"{no_longer_coaxial(self.text)}. {accepts}")
            raise CaptureError(
                f"{found}, and {accepts}. Use a method for any rig, such as dual photography; or "
                "align a real rig's two devices to a fraction of a pixel, and focus both; a "
                "simulated one's matrix must equal its transpose"
            )
        wished: float = min(accepted, getattr(options, "target_error", None) or accepted)
        chosen = method.on_rig(self.least <= wished)
        if not aloud:
            return chosen
        if chosen is not method:
            _log.info(
                "taking the rig for a coaxial one makes an error of %.1f%% +- %.1f%% in relit "
                "pictures: going on by %s",
                100 * self.error, 100 * self.standard_error, chosen.title.lower(),
            )  # fmt: skip
        elif self.least > _WORTH_A_WORD * accepted:
            _log.warning("%s; %s", found, accepts)
        return chosen


def no_longer_coaxial(text: str) -> str:
    """Message about a rig that was coaxial when it was calibrated; `text` describes it now."""
    return (
        f"this rig was coaxial when it was calibrated; it no longer is: {text}. Check cables, "
        "mirroring and what may have moved, then calibrate again (rfpipe calibrate --again)"
    )


def measured(
    folder: AcquisitionFolder, merger: Merger, brightness: NDArray[np.float64] | None = None
) -> dict[str, Any]:
    """Measure a rig by the random patterns that level 0 began with, if any, for the manifest.

    Their pictures are divided by the lamp's `brightness` (count, C): its drift would look like
    asymmetry.
    """
    if SYMMETRY not in folder.read_manifest(0, "capture"):
        return {}
    with folder.frames(0, "capture", SYMMETRY) as frames:
        count = frames.shape[0]
        merged = [merger.merge(frames.read(index, index + 1), index) for index in range(count)]
    taken = (
        np.concatenate([getattr(one, name) for one in merged]) for name in ("radiance", "variance")
    )
    floodlit, variance = _flat(np.stack([merger.floodlit, merger.floodlit_variance]))
    signs = random_signs(merger.floodlit.shape[:-1], count, seed=0)
    pictures = Pictures(signs.reshape(count, -1), *map(_flat, taken))
    if brightness is not None:
        over = brightness[:, None]
        pictures = Pictures(signs.reshape(count, -1), pictures[1] / over, pictures[2] / over**2)
    error, standard_error = measure_symmetry(floodlit, variance, pictures)
    # Light from pixels that aren't known is seen one way alone: at most so much, if indirect.
    unseen = _MASKED * float(np.mean(~np.isfinite(merger.floodlit_variance)))
    error = float(np.sqrt(max(error**2 - unseen, 0)))
    place, excess = _place(signs, pictures, floodlit), _excess(pictures, floodlit)
    asymmetry = Asymmetry(error, standard_error, place, excess)
    return {SYMMETRY: {**asdict(asymmetry), "frames": count}}


def _excess(pictures: Pictures, floodlit: NDArray[np.float64]) -> float:
    """Light of pictures beyond that by the white picture, relative to it, if it surely is there.

    On a coaxial rig ``1^T T p = p^T T 1``.
    """
    white = floodlit.sum(axis=-1)
    total = float(white.sum()) or 1.0
    expected = (pictures.signs @ white + total) / 2
    excess = (pictures.radiance.sum(axis=(1, 2)) - expected) / total
    mean, deviation = float(excess.mean()), float(excess.std(ddof=1) / np.sqrt(len(excess)))
    is_sure = abs(mean) > max(_LEAST_EXCESS, _SURE * deviation)
    return mean if is_sure else 0.0


def _place(signs: NDArray[np.float64], pictures: Pictures, floodlit: NDArray[np.float64]) -> str:
    if signs.ndim != 3:  # an array of views
        return ""
    light = pictures.radiance.sum(axis=-1).reshape(signs.shape)
    return placement_of(signs, light, floodlit.sum(axis=-1).reshape(signs.shape[1:])).text


def _flat(images: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return images as (B, N, C); pixels that aren't known are 0, forth and back alike."""
    flat = images.reshape(len(images), -1, images.shape[-1]).astype(np.float64)
    return np.where(np.isfinite(flat), flat, 0.0)


def read_asymmetry(folder: AcquisitionFolder) -> Asymmetry | None:
    """Read what level 0's merge measured; None where nothing was measured."""
    facts = folder.read_manifest(0, "merge").get(SYMMETRY) if folder.exists(0, "merge") else None
    if facts is None:
        return None
    numbers = (facts["error"], facts["standard_error"])
    return Asymmetry(*numbers, facts.get("place", ""), facts.get("excess", 0.0))
