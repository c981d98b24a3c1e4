"""Base class of simulated scenes, and application of their transport to patterns."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError

if TYPE_CHECKING:
    from rfpipe.config import SceneSettings

# Patterns per matrix product; padding to a larger number would slow down small batches.
_PATTERNS_AT_A_TIME = 16


class Scene(ABC):
    """Ground-truth transport of a simulated scene, from patterns to radiance.

    Settings name a kind of scene by its entry point in the group ``rfpipe.scenes``, or by a path,
    ``module:Class`` or ``file.py:Class``. A user's scene derives from this class and is created by
    ``MyScene(options)``. `rfpipe.testing.SceneContract` tests it.

    Parameters
    ----------
    camera_shape, projector_shape
        Shapes of the ray domains, of M and of N rays: (H, W), or (V, H, W) for an array of views.
    channels
        Colour channels, C: 1 or 3.

    Attributes
    ----------
    Options
        A pydantic model; each field has a description with unit and range.
    """

    Options: ClassVar[type[SceneSettings]]

    def __init__(
        self, camera_shape: tuple[int, ...], projector_shape: tuple[int, ...], channels: int
    ) -> None:
        self.camera_shape = tuple(camera_shape)
        self.projector_shape = tuple(projector_shape)
        self.channels = channels

    @classmethod
    def make(cls, options: Any) -> Scene:
        """Create the scene from its `Options`."""
        scene: Scene = cls(options)  # type: ignore[call-arg]
        return scene

    @abstractmethod
    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape)."""

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Plain data of everything that determines the transport, for fingerprints (JSON)."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the ray domain of a coaxial rig."""
        return self.camera_shape

    @property
    def recorded(self) -> dict[str, Any]:
        """Noise and software of a Monte Carlo ground truth, as plain data; empty if it is exact.

        ``grain``: standard error of a half-lit picture relative to its norm, of the ``whole``
        picture and of pixels without direct light (``unlit``). ``versions`` of the software.
        """
        return {}

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Albedo float32 (*camera_shape, C) for display; by default the scaled floodlit image."""
        image = self.apply(np.ones((1, math.prod(self.projector_shape))))
        brightest = float(image.max())
        image /= brightest if brightest > 0 else 1
        return image.reshape(*self.camera_shape, self.channels)

    def dense(self, channel: int = 0) -> NDArray[np.float64]:
        """The full matrix (M, N) of one channel, for small scenes."""
        columns = self.apply(np.eye(math.prod(self.projector_shape)))
        return columns[..., channel].T.astype(np.float64)


class CoaxialScene(Scene):
    """A scene whose camera and projector share their rays, so that ``T = T^T`` (2.10)."""

    def __init__(self, shape: tuple[int, ...], channels: int) -> None:
        super().__init__(shape, shape, channels)


def scene_from_config(settings: SceneSettings) -> Scene:
    """Build the scene of settings such as ``SceneSettings.of("wedge", shape=(62, 70))``.

    Raises InputError for a captured scene, whose light transport is unknown.
    """
    scene: Scene = settings.plugin.make(settings)
    return scene


def apply_in_batches(
    radiance: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    patterns: ArrayLike,
    shape: tuple[int, ...],
    channels: int,
    camera_rays: int | None = None,
    *,
    padded: bool = True,
) -> NDArray[np.float32]:
    """Apply an operator to patterns in batches, of a fixed size if `padded`.

    Rounding of a dense matrix product may depend on its number of columns. With a fixed number, a
    pattern's radiance doesn't depend on the batch, so that a resumed capture has the same bytes.

    Parameters
    ----------
    radiance
        The operator: weights float64 (N, b) to radiance float64 (M, b, C).
    patterns
        (B, N) or (B, *shape): weights of the rays, in image order.
    shape
        Shape of the projector's ray domain, of N rays.
    channels
        Number of colour channels, C.
    camera_rays
        Number of the camera's rays, M; N where None.
    padded
        Fill batches with dark patterns; unnecessary for sparse matrices.

    Returns
    -------
    float32 (B, M, C)

    Raises
    ------
    InputError
        If the patterns have another shape, or a weight is not finite.
    """
    weights, rays = weights_of(patterns, shape), math.prod(shape)
    out = np.empty((len(weights), camera_rays or rays, channels), dtype=np.float32)
    for start in range(0, len(weights), _PATTERNS_AT_A_TIME):
        part = weights[start : start + _PATTERNS_AT_A_TIME]
        columns = np.zeros((rays, _PATTERNS_AT_A_TIME if padded else len(part)))
        columns[:, : len(part)] = part.T
        out[start : start + len(part)] = radiance(columns).transpose(1, 0, 2)[: len(part)]
    return out


def weights_of(patterns: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """Reshape patterns (B, N) or (B, *shape) to (B, N); InputError for any other shape."""
    weights, rays = np.asarray(patterns), math.prod(shape)
    if weights.ndim < 2 or weights.shape[1:] not in {(rays,), tuple(shape)}:
        raise InputError(
            f"patterns of shape {weights.shape}: expected (patterns, {rays}) or "
            f"(patterns, {', '.join(map(str, shape))})"
        )
    if not np.isfinite(weights).all():
        raise InputError("patterns: every weight should be finite, found NaN or infinity")
    return weights.reshape(len(weights), rays)
