"""What footprints say of indirect light: the factors of both sides, and the way between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.methods.footprints.typed import Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["Carry", "camera_factor", "carry_of", "projector_factor", "shared_rays"]

# Direct light as a part of the floodlit image from which on a pixel counts as lit, what its
# indirect light may be of it at least and at most, in the factor.
_LIT, _LEAST, _MOST_RATIO = 0.5, 0.03, 20.0
# Light that comes back from a projector pixel, relative to what the camera sees, at which it is
# half seen, and below which it is not.
_HALF_SEEN, _UNSEEN = 0.15, 0.05


@dataclass(frozen=True)
class Carry:
    """How functions over the camera's pixels become functions over the projector's.

    A projector pixel takes the mean of the camera pixels that see what it lights.

    Attributes
    ----------
    means : csr_array of float32, shape (projector pixels, camera pixels)
        Rows of sum 1, or 0 where nothing is seen.
    seen : ndarray of float32, shape (projector pixels,)
        How well the camera sees what a projector pixel lights, 0 to 1.
    shared : bool
        Whether each projector pixel is the camera pixel of the same number.
    """

    means: csr_array[np.float32]
    seen: Float
    shared: bool = False


def carry_of(direct: csr_array[np.float32], floodlit: Float) -> Carry:
    """Take the way from camera to projector out of the footprints.

    Parameters
    ----------
    direct : csr_array of float32, shape (camera pixels, projector pixels)
        Footprints.
    floodlit : ndarray of float32, shape (camera pixels,)
    """
    sent: Float = np.asarray(direct.sum(axis=0)).ravel()
    means = _rows_scaled(direct.T, np.divide(1, sent, out=np.zeros_like(sent), where=sent > 0))
    typical = means @ floodlit
    share = np.divide(sent, typical, out=np.zeros_like(sent), where=typical > 0)
    # where a camera pixel covers several projector pixels each gets a part of its light
    usual = float(np.median(share[share > 0])) if (share > 0).any() else 1.0
    share = share / usual
    seen = np.where(share > _UNSEEN, share / (share + _HALF_SEEN), 0)
    return Carry(means, seen.astype(np.float32))


def shared_rays(size: int) -> Carry:
    """Return the way between the sides of a coaxial rig of so many rays."""
    from scipy.sparse import eye_array

    return Carry(eye_array(size, dtype=np.float32).tocsr(), np.ones(size, np.float32), True)


def camera_factor(direct: csr_array[np.float32], floodlit: Float) -> Float:
    """Return how much indirect light each camera pixel takes, in units of the floodlit image.

    It is what the floodlit image has besides direct light, so that it has no jump at the edge of a
    shadow, scaled to be as bright as the floodlit image where a pixel is lit.
    """
    lit: Float = np.asarray(direct.sum(axis=1)).ravel()
    rest = np.maximum(floodlit - lit, 1e-6 * floodlit)
    own = (lit > _LIT * floodlit) & (rest > 0)
    ratio = np.clip(np.median(floodlit[own] / rest[own]), 1, _MOST_RATIO) if own.any() else 1.0
    found: Float = (np.clip(rest, _LEAST * floodlit, floodlit) * ratio).astype(np.float32)
    return found


def projector_factor(carry: Carry, factor: Float, floodlit: Float) -> Float:
    """Return how much indirect light each projector pixel gives, in the same units.

    Where the camera doesn't see it, it is as much as of a typical pixel.
    """
    shining = floodlit[floodlit > 0]
    typical = float(np.median(shining)) if len(shining) else 0.0
    found: Float = carry.seen * (carry.means @ factor) + (1 - carry.seen) * np.float32(typical)
    return found.astype(np.float32)


def _rows_scaled(matrix: Any, scale: Float) -> csr_array[np.float32]:
    from scipy.sparse import diags_array

    scaled: csr_array[np.float32] = (diags_array(scale) @ matrix).tocsr().astype(np.float32)
    return scaled
