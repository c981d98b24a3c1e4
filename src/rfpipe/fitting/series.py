"""Pictures of one scene under known light, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import prod

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import ray_shape
from rfpipe.errors import InputError

_ARRAYS = ("patterns", "radiance", "variance")


@dataclass(frozen=True, eq=False)
class Series:
    """Pictures of one scene under known light.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        Of M and of N rays; lights without a grid are a row, (1, N).
    patterns : ndarray of float32, shape (K, 1, N) or (K, C, N); (K, N) is taken, too
        Light of each ray in each picture, finite, at least 0: white, or one for each channel.
    radiance : ndarray of float32, shape (K, C, M)
        Linear, without the light of anything else; finite.
    variance : ndarray of float32, shape (K, C, M)
        Variance of `radiance`, at least 0; 0 for exact light, and infinite in all pictures for a
        camera ray that is unknown.
    names : sequence of K str
        Of the pictures; empty where they have none.
    lights : ndarray of float32, shape (N, 3), optional
        Directions of the projector's rays, where these are single lights.
    validation : ndarray of bool, shape (K,), or empty
        Pictures that are kept from all fits, to estimate their error.
    notes : tuple of str
        Remarks on the pictures for the user.

    Raises
    ------
    InputError
        When shapes don't fit together or a value is out of range.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    patterns: Float = field(repr=False)
    radiance: Float = field(repr=False)
    variance: Float = field(repr=False)
    names: Sequence[str] = ()
    lights: Float | None = None
    validation: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        rays = prod(ray_shape(self.camera_shape, "camera_shape"))
        lights = prod(ray_shape(self.projector_shape, "projector_shape"))
        count = len(self.patterns)
        pictures = (count, self.channels, rays)
        patterns = np.asarray(self.patterns)
        if patterns.ndim == 2:
            object.__setattr__(self, "patterns", patterns[:, None])
        shown = (count, 1 if patterns.shape[1:-1] in ((), (1,)) else self.channels, lights)
        for name, shape in (
            ("patterns", shown), ("radiance", pictures), ("variance", pictures)
        ):  # fmt: skip
            values = np.asarray(getattr(self, name))  # of other libraries, too
            object.__setattr__(self, name, values)
            if values.shape != shape:
                raise InputError(f"{name} has the shape {values.shape}; expected {shape}")
            is_valid = np.isfinite(values) if name != "variance" else ~np.isnan(values)
            if not is_valid.all() or (name != "radiance" and (values < 0).any()):
                raise InputError(f"{name} should be finite and not negative, every value")
        if self.channels not in (1, 3):
            raise InputError(f"pictures have {self.channels} channels; expected 1 or 3")
        if not self.patterns.any(axis=(0, 2)).all():
            raise InputError("all patterns are dark, or there are none: they tell nothing of light")

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.radiance.shape[1])

    @property
    def known(self) -> NDArray[np.bool_]:
        """Camera rays that the pictures show, bool (M,)."""
        return np.asarray(np.isfinite(self.variance).all(axis=(0, 1)))

    def by_light(self) -> list[Series]:
        """Split coloured patterns into channels; white ones stay together."""
        if self.patterns.shape[1] == 1:
            return [self]
        return [
            replace(self, **{name: getattr(self, name)[:, [channel]] for name in _ARRAYS})
            for channel in range(self.channels)
        ]

    @property
    def grey(self) -> Series:
        """The sum of the channels of pictures of white patterns; coloured ones are returned."""
        if self.patterns.shape[1] > 1 or self.channels == 1:
            return self
        sums = {name: getattr(self, name).sum(axis=1, keepdims=True) for name in _ARRAYS[1:]}
        return replace(self, **sums)

    @property
    def rank(self) -> int:
        """Number of independent patterns, of coloured ones in the channel that has the fewest."""
        patterns = np.moveaxis(self.patterns, 1, 0).astype(np.float64)
        values = np.linalg.eigvalsh(patterns @ patterns.swapaxes(1, 2))
        return int(np.count_nonzero(values > 1e-10 * values[:, -1:], axis=1).min())

    @property
    def is_complete(self) -> bool:
        """The patterns determine each ray (bool)."""
        lights = self.patterns.shape[-1]
        return bool(len(self.patterns) >= lights and self.rank == lights)

    @property
    def are_single_lights(self) -> bool:
        """Each picture shows one projector ray, and each ray has one picture (bool)."""
        lit = self.patterns.any(axis=1)
        return lit.shape[0] == lit.shape[1] and bool(
            (lit.sum(axis=0) == 1).all() and (lit.sum(axis=1) == 1).all()
        )

    def of_rays(self, chosen: NDArray[np.int64]) -> Series:
        """Return the pictures of some camera rays, as a row of them."""
        parts = {name: getattr(self, name)[..., chosen] for name in ("radiance", "variance")}
        return replace(self, camera_shape=(1, len(chosen)), **parts)

    def some(self, chosen: NDArray[np.int64]) -> Series:
        """Return some of the pictures, none of them for validation."""
        parts = {name: getattr(self, name)[chosen] for name in _ARRAYS}
        names = [self.names[index] for index in chosen] if self.names else ()
        return replace(self, **parts, names=names, validation=np.zeros(0, np.bool_))

    @property
    def training(self) -> Series:
        """The pictures that aren't for validation."""
        every = np.arange(len(self.patterns))
        return self.some(np.setdiff1d(every, np.flatnonzero(self.validation)))
