"""The pictures from which near/far acquisition infers indirect light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float, Pack
from rfpipe.methods.held_out.rounds import gathered, latest

__all__ = ["SIGNIFICANT", "Pictures", "completed"]

SIGNIFICANT = 3.0
"""What exceeds noise by so many standard deviations is light."""


@dataclass(frozen=True)
class Pictures:
    """Pictures of patterns of light and dark.

    Attributes
    ----------
    floodlit, floodlit_variance : ndarray of float32, shape (C, N)
        The variance is infinite where a pixel is unknown: no fit, test or estimate looks at it.
    lit : ndarray of bool, shape (M, N)
        The patterns.
    radiance, variance : ndarray of float32, shape (M, C, N)
    """

    floodlit: Float
    floodlit_variance: Float
    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float

    @property
    def channels(self) -> int:
        """Colour channels."""
        return len(self.floodlit)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Pixels that the pictures show, (N,)."""
        return np.asarray(np.isfinite(self.floodlit_variance).all(axis=0))

    def shine(self) -> bool:
        """Tell whether the floodlit image as a whole is brighter than its noise."""
        known = self.known
        light = float(self.floodlit[:, known].sum(dtype=np.float64))
        noise = float(np.sqrt(self.floodlit_variance[:, known].sum(dtype=np.float64)))
        return light > SIGNIFICANT * noise

    def extended(self, lit: NDArray[np.bool_], radiance: Float, variance: Float) -> Pictures:
        """Return these and more pictures."""
        return replace(
            self,
            lit=np.concatenate([self.lit, lit]),
            radiance=np.concatenate([self.radiance, radiance]),
            variance=np.concatenate([self.variance, variance]),
        )

    def latest(self, count: int) -> dict[str, NDArray[Any]]:
        """Return the arrays of the last ones by name."""
        arrays = latest(self, count)
        del arrays["floodlit"], arrays["floodlit_variance"]
        return arrays

    @classmethod
    def restored(cls, packs: Sequence[Pack]) -> Pictures:
        """Return those of packs, the first of which has the floodlit image."""
        lit, variance = (packs[0].arrays[name] for name in ("floodlit", "floodlit_variance"))
        found = gathered(cls, packs, floodlit=lit, floodlit_variance=variance)
        assert found is not None
        return found

    def channel(self, index: int) -> Pictures:
        """Return one channel."""
        own = slice(index, index + 1)
        return Pictures(
            self.floodlit[own],
            self.floodlit_variance[own],
            self.lit,
            self.radiance[:, own],
            self.variance[:, own],
        )

    def grey(self) -> Pictures:
        """Return the sum of the channels as one."""
        return Pictures(
            self.floodlit.sum(axis=0, keepdims=True),
            self.floodlit_variance.sum(axis=0, keepdims=True),
            self.lit,
            self.radiance.sum(axis=1, keepdims=True),
            self.variance.sum(axis=1, keepdims=True),
        )


def completed(shape: tuple[int, ...], floodlit: Float, variance: Float) -> Float:
    """Return a floodlit image (C, N) whose unknown pixels are as bright as the nearest known one.

    The model takes from it how much light a ray sends; a pixel that nobody sees still lights
    others.
    """
    from scipy.ndimage import distance_transform_edt

    unknown = np.isinf(variance).any(axis=0)
    if not unknown.any():
        return floodlit
    nearest = distance_transform_edt(
        unknown.reshape(shape), return_distances=False, return_indices=True
    )
    image: Float = floodlit[:, np.ravel_multi_index(tuple(nearest), shape).ravel()]
    return image
