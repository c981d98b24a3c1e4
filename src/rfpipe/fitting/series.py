"""Pictures with the patterns that they show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import prod

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import ray_shape
from rfpipe.errors import InputError

Float = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Series:
    """Pictures of one scene under known light.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        Of M and of N rays; lights that stand in no grid are a row, (1, N).
    patterns : ndarray of float32, shape (K, N)
        Light of each ray in each picture, finite, at least 0.
    radiance : ndarray of float32, shape (K, C, M)
        Linear, without the light of anything else; finite.
    variance : ndarray of float32, shape (K, C, M)
        Of `radiance`, at least 0; 0 where nothing is known of it.

    Raises
    ------
    InputError
        When shapes don't fit together or a value is out of range.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    patterns: Float
    radiance: Float
    variance: Float

    def __post_init__(self) -> None:
        rays = prod(ray_shape(self.camera_shape, "camera_shape"))
        lights = prod(ray_shape(self.projector_shape, "projector_shape"))
        count = len(self.patterns)
        pictures = (count, self.channels, rays)
        for name, shape in (
            ("patterns", (count, lights)), ("radiance", pictures), ("variance", pictures)
        ):  # fmt: skip
            values = getattr(self, name)
            if values.shape != shape:
                raise InputError(f"{name} has the shape {values.shape}; expected {shape}")
            if not np.isfinite(values).all() or (name != "radiance" and (values < 0).any()):
                raise InputError(f"{name} should be finite and not negative, every value")
        if self.channels not in (1, 3):
            raise InputError(f"pictures have {self.channels} channels; expected 1 or 3")
        if not self.patterns.any():
            raise InputError("all patterns are dark, or there are none: they tell nothing of light")

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.radiance.shape[1])

    @property
    def is_binary(self) -> bool:
        """Whether patterns are full light and none."""
        return bool(((self.patterns == 0) | (self.patterns == 1)).all())

    @property
    def rank(self) -> int:
        """Number of independent patterns."""
        gram = self.patterns.astype(np.float64) @ self.patterns.T.astype(np.float64)
        values = np.linalg.eigvalsh(gram)
        return int(np.count_nonzero(values > 1e-10 * values[-1]))

    @property
    def is_complete(self) -> bool:
        """Whether the patterns tell of each ray by itself."""
        lights = self.patterns.shape[1]
        return bool(len(self.patterns) >= lights and self.rank == lights)

    def some(self, chosen: NDArray[np.int64]) -> Series:
        """Return some of the pictures."""
        parts = {name: getattr(self, name)[chosen] for name in ("patterns", "radiance", "variance")}
        return replace(self, **parts)
