"""Light that bounces between diffuse surface points.

With r the albedo, A the points' areas and G the form factors between them, flux f on the points
leaves them as radiosity ``(diag(r / A) + diag(r) G diag(r) + diag(r) G diag(r A) G diag(r) + ...)
f``: direct light, second bounce, third bounce. The matrix is symmetric.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import Scene, apply_in_batches
from rfpipe.scenes.facing import facing_pairs
from rfpipe.scenes.formfactors import FormFactors, form_factors
from rfpipe.scenes.geometry import Points
from rfpipe.scenes.occluders import Occluder

__all__ = ["DENSE_POINTS", "DiffuseScene", "DiffuseSurfaces", "Patches"]

DENSE_POINTS = 8192  # above which a dense matrix is refused: it would take over half a gigabyte


@dataclass(frozen=True)
class Patches:
    """Neighbouring points taken together, for light that comes from afar and varies slowly.

    The form factors between points are those of their patches.

    Parameters
    ----------
    points
        The patches, each as a point.
    of_point
        int64 (N,): the patch that each of the N finer points belongs to.
    """

    points: Points
    of_point: NDArray[np.int64]


class DiffuseSurfaces:
    """Surface points, their albedo, and what may stand between them.

    Parameters
    ----------
    points
        The N points.
    albedo
        float64 (N, C) in [0, 1).
    bounces
        Light simulated: 1 is direct light alone, each further one adds an inter-reflection.
    occluders
        What blocks light between points.
    compress
        Whether to compress the form factors; None decides by their number.
    patches
        Between which the form factors are taken; between the points themselves where None.

    Raises
    ------
    InputError
        If albedo or bounces are out of range.
    """

    def __init__(
        self,
        points: Points,
        albedo: NDArray[np.float64],
        *,
        bounces: int,
        occluders: Sequence[Occluder] = (),
        compress: bool | None = None,
        patches: Patches | None = None,
    ) -> None:
        if not ((albedo >= 0) & (albedo < 1)).all():
            raise InputError("albedo: every value should be at least 0 and below 1")
        if bounces < 1:
            raise InputError(f"bounces {bounces}: expected at least 1, the direct light")
        self.points = points
        self.albedo = albedo
        self.bounces = bounces
        self.occluders = tuple(occluders)
        self.compress = compress
        self.patches = patches

    @property
    def channels(self) -> int:
        """Colour channels."""
        return int(self.albedo.shape[1])

    @cached_property
    def form_factors(self) -> FormFactors:
        """The operator G, built when it is first used."""
        points, of_point = self._meshed
        return form_factors(points, self.occluders, compress=self.compress, of_point=of_point)

    @property
    def _meshed(self) -> tuple[Points, NDArray[np.int64] | None]:
        """The points between which G is taken, and which of them stands for each point."""
        if self.patches is None:
            return self.points, None
        return self.patches.points, self.patches.of_point

    def radiosity(self, flux: NDArray[np.float64]) -> NDArray[np.float64]:
        """Light that leaves the points under flux (N, B) on them: float64 (N, B, C)."""
        albedo, areas = self.albedo[:, None, :], self.points.areas[:, None, None]
        reflected = flux[..., None] * albedo  # leaves a point, per unit of its area
        total = reflected / areas
        for _ in range(1, self.bounces):
            columns = reflected.reshape(len(flux), -1)
            received = self.form_factors.apply(columns).reshape(reflected.shape)
            received *= albedo
            total += received
            reflected = received * areas
        return total

    def dense(self, channel: int) -> NDArray[np.float64]:
        """The matrix (N, N) of one channel, exact and exactly symmetric, of few points."""
        albedo, areas = self.albedo[:, channel], self.points.areas
        matrix = np.diag(albedo / areas)
        if self.bounces > 1:
            geometry = self._dense_form_factors()
            bounce = np.outer(albedo, albedo) * geometry
            matrix += bounce
            for _ in range(2, self.bounces):
                bounce = (albedo[:, None] * geometry * areas) @ bounce
                matrix += (bounce + bounce.T) / 2  # products round: symmetric by rounding alone
        return matrix

    def _dense_form_factors(self) -> NDArray[np.float64]:
        """G with every entry, (N, N)."""
        points, of_point = self._meshed
        geometry = np.zeros((len(points.areas), len(points.areas)))
        for pair in facing_pairs(points, self.occluders):
            first, second = pair.indices
            geometry[np.ix_(first, second)] = block = pair.block()
            geometry[np.ix_(second, first)] = block.T
        return geometry if of_point is None else geometry[np.ix_(of_point, of_point)]


class DiffuseScene(Scene):
    """A scene whose light is that between `DiffuseSurfaces`.

    Attributes
    ----------
    name : str
        What the scene is called in its description.
    """

    name: str
    _surfaces: DiffuseSurfaces

    @abstractmethod
    def _radiance(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance (M, B, C) of patterns (N, B)."""

    @abstractmethod
    def _matrix(self, channel: int) -> NDArray[np.float64]:
        """The matrix (M, N) of one channel."""

    @property
    def _rays(self) -> int:
        """Number of the camera's rays."""
        return math.prod(self.camera_shape)

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Albedo (*camera_shape, C) in [0, 1) that the camera sees, float32; 0 of an occluder."""
        seen = self._surfaces.albedo[: self._rays]
        return seen.reshape(*self.camera_shape, self.channels).astype(np.float32)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance under projected patterns.

        A pattern's radiance doesn't depend on the patterns beside it, see `apply_in_batches`.

        Parameters
        ----------
        patterns
            (B, N) or (B, *projector_shape): weights of the rays, in image order.

        Returns
        -------
        float32 (B, M, C)
            In units in which direct light is albedo x mean(A) / A, times the light's strength.

        Raises
        ------
        InputError
            If the patterns don't have N rays each.
        """
        return apply_in_batches(
            self._radiance, patterns, self.projector_shape, self.channels, self._rays
        )

    def dense(self, channel: int = 0) -> NDArray[np.float64]:
        """The whole matrix (M, N) of one channel; exactly symmetric, of a coaxial scene.

        Raises
        ------
        InputError
            Above `DENSE_POINTS` rays or points of surfaces, or for a channel that doesn't exist.
        """
        count = max(self._rays, len(self._surfaces.albedo))
        if count > DENSE_POINTS:
            raise InputError(
                f"a dense matrix of {count} rays or points would take {8e-9 * count**2:.1f} GB; "
                f"dense() is for at most {DENSE_POINTS}, apply() for any number"
            )
        if not 0 <= channel < self.channels:
            raise InputError(f"channel {channel}: expected 0 to {self.channels - 1}")
        return self._matrix(channel)

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            "scene": self.name,
            "channels": self.channels,
            "albedo": fingerprint(self._surfaces.albedo),
            "bounces": self._surfaces.bounces,
            "compress": self._surfaces.compress,
        }
