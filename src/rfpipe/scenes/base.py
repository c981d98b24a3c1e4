"""What every simulated scene offers, and how patterns are put through one."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError

__all__ = ["Scene", "apply_in_batches"]

_PATTERNS_AT_A_TIME = 16


class Scene(Protocol):
    """Ground-truth transport of a simulated scene under a coaxial rig: patterns in, radiance out.

    N is the number of rays, C the number of colour channels.
    """

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the ray domain, of N rays."""
        ...

    @property
    def channels(self) -> int:
        """Colour channels, 1 or 3."""
        ...

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Albedo seen by each ray, float32 (*shape, C)."""
        ...

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, N, C) under patterns (B, N) or (B, *shape)."""
        ...

    def dense(self, channel: int = 0) -> NDArray[np.float64]:
        """The whole matrix (N, N) of one channel, of a small scene."""
        ...

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        ...


def apply_in_batches(
    radiance: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    patterns: ArrayLike,
    shape: tuple[int, ...],
    channels: int,
) -> NDArray[np.float32]:
    """Put patterns through an operator, always the same number at a time.

    A matrix product may round differently for another number of columns. With a fixed number, and
    float64 sums that are rounded to float32 at the end, a pattern's radiance is the same whichever
    patterns stand beside it, and a capture that is resumed repeats its bytes.

    Parameters
    ----------
    radiance
        The operator: weights float64 (N, b) to radiance float64 (N, b, C), b fixed.
    patterns
        (B, N) or (B, *shape): weights of the rays, in image order.
    shape
        Shape of the ray domain, of N rays.
    channels
        Number of colour channels, C.

    Returns
    -------
    float32 (B, N, C)

    Raises
    ------
    InputError
        If the patterns have another shape, or a weight is not finite.
    """
    weights = np.asarray(patterns)
    rays = math.prod(shape)
    if weights.ndim < 2 or weights.shape[1:] not in {(rays,), tuple(shape)}:
        raise InputError(
            f"patterns of shape {weights.shape}: expected (patterns, {rays}) or "
            f"(patterns, {', '.join(map(str, shape))})"
        )
    weights = weights.reshape(len(weights), rays)
    if not np.isfinite(weights).all():
        raise InputError("patterns: every weight should be finite, found NaN or infinity")
    out = np.empty((len(weights), rays, channels), dtype=np.float32)
    for start in range(0, len(weights), _PATTERNS_AT_A_TIME):
        part = weights[start : start + _PATTERNS_AT_A_TIME]
        padded = np.zeros((rays, _PATTERNS_AT_A_TIME))
        padded[:, : len(part)] = part.T
        out[start : start + len(part)] = radiance(padded).transpose(1, 0, 2)[: len(part)]
    return out
