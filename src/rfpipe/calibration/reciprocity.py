"""Reciprocity: whether each picture of an acquisition agrees with T = T' (2.10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float32]
Double = NDArray[np.float64]

_UNKNOWN = 0.5  # squared error that unknown pixels may seem to make, for their share
_WITNESSES = 24  # pictures that each new one is held against: chance has no say in so many


@dataclass(frozen=True)
class Residual:
    """How one picture agrees with the previous ones.

    Attributes
    ----------
    deviations : float
        RMS of ``p' c_q - q' c_p`` over its standard deviation by the noise: 1 on a right rig, 0
        where there is nothing to be held against.
    error : float
        What taking T for symmetric makes wrong in this picture, relative to its norm: at least so
        much, as far as the previous patterns tell.
    """

    deviations: float
    error: float

    def is_wrong(self, worth_a_word: float, significance: float = 6.0) -> bool:
        """Whether it is more than noise, and more than is worth a word."""
        return self.deviations > significance and self.error > worth_a_word


class Reciprocity:
    """Holds each picture of a coaxial rig against previous ones of the acquisition.

    Parameters
    ----------
    floodlit, variance : ndarray of float32, shape (*camera_shape, C)
        The floodlit image and its variance: the first witness. Infinite variance: not known.

    Notes
    -----
    With ``T = T'``, light from where pattern q is lit to where p is lit is what goes from p to q:
    ``p' c_q = q' c_p``. Of picture q and the witnesses p the residual is ``r_p = p' c_q g - q'
    c_p``, with one gain g for each channel, found by least squares, so that a lamp that drifts is
    no asymmetry. ``r = W K q`` of ``K = T - T'`` is the projection of ``K q`` on the witnesses, the
    rows of W: ``r' (W W')^+ r <= |K q|^2``, and a picture under q is wrong by ``K q / 2``. The
    noise's share of both is known and is taken off.
    """

    def __init__(self, floodlit: Float, variance: Float) -> None:
        known = np.isfinite(variance)
        rays, channels = known[..., 0].size, floodlit.shape[-1]
        self._unseen = _UNKNOWN * (1 - float(known.mean()))
        self._patterns = np.empty((_WITNESSES, rays), np.float32)
        self._images, self._noise = np.empty((2, _WITNESSES, rays, channels), np.float32)
        self._gram = np.zeros((_WITNESSES, _WITNESSES))
        self._count = 0
        self._keep(np.ones(rays, np.float32), *_flat(floodlit, variance))

    def judge(self, pattern: Float, radiance: Float, variance: Float) -> Residual:
        """Hold a picture against the previous ones, and keep it as a witness.

        Parameters
        ----------
        pattern : ndarray of float32, shape (*projector_shape)
        radiance, variance : ndarray of float32, shape (*camera_shape, C)
        """
        q = np.asarray(pattern, np.float32).reshape(-1)
        image, noise = _flat(radiance, variance)
        held = min(self._count, _WITNESSES)
        patterns, images = self._patterns[:held], self._images[:held]
        back = np.tensordot(q, images, (0, 1)).astype(np.float64)  # q' c_p, (P, C)
        ahead = (patterns @ image).astype(np.float64)  # p' c_q
        spread = np.tensordot(q * q, self._noise[:held], (0, 1)).astype(np.float64)
        spread += (patterns * patterns) @ noise
        spread = np.maximum(spread, np.finfo(np.float32).eps ** 2 * np.maximum(ahead, back) ** 2)
        sure = np.divide(1, spread, out=np.zeros_like(spread), where=spread > 0)
        over, above = (sure * ahead * ahead).sum(axis=0), (sure * ahead * back).sum(axis=0)
        gain = np.divide(above, over, out=np.ones_like(over), where=over > 0)
        image, noise = (part.astype(np.float32) for part in (image * gain, noise * gain**2))
        found = self._residual(ahead * gain - back, spread, image, noise)
        self._keep(q, image, noise)
        return found

    def _residual(self, residual: Double, spread: Double, image: Float, noise: Float) -> Residual:
        held, channels = residual.shape
        light = float((np.square(image) - noise).sum(dtype=np.float64))
        if held < 2 or light <= 0:
            return Residual(0.0, 0.0)
        squares = np.divide(residual**2, spread, out=np.zeros_like(spread), where=spread > 0)
        deviations = float(np.sqrt(squares.sum() / ((held - 1) * channels)))
        values, vectors = np.linalg.eigh(self._gram[:held, :held])
        # directions of pattern space that the witnesses hardly span are all noise
        chosen = values > 0.05 * np.diag(self._gram)[:held].min()
        ways = vectors[:, chosen]
        along = (ways.T @ residual) ** 2 - (ways**2).T @ spread
        error = float((along.sum(axis=1) / values[chosen]).sum()) / (4 * light) - self._unseen
        return Residual(deviations, float(np.sqrt(max(error, 0.0))))

    def _keep(self, pattern: Float, image: Float, noise: Float) -> None:
        """Keep a witness; the floodlit image stays, the others make way in turn."""
        if not pattern.any():
            return
        at = self._count
        if at >= _WITNESSES:
            at = 1 + (at - _WITNESSES) % (_WITNESSES - 1)
        self._count += 1
        self._patterns[at], self._images[at], self._noise[at] = pattern, image, noise
        held = min(self._count, _WITNESSES)
        self._gram[at, :held] = self._gram[:held, at] = self._patterns[:held] @ pattern


def _flat(radiance: Float, variance: Float) -> tuple[Float, Float]:
    """Return an image and its variance as (N, C); pixels that aren't known are 0 in both."""
    known = np.isfinite(variance)
    flat = (np.where(known, image, 0) for image in (radiance, variance))
    image, noise = (each.reshape(-1, radiance.shape[-1]).astype(np.float32) for each in flat)
    return image, noise
