"""Light transport between diffuse planes as a coaxial rig sees it [thesis 2.2, Fig. 2.1].

With r the albedo, A the pixels' areas and G the form factors between points,
``T = mean(A) (diag(r / A) + diag(r) G diag(r) + diag(r) G diag(r A) G diag(r) + ...)``:
direct light, second bounce, third bounce. T is symmetric, as in eq. (2.10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import apply_in_batches
from rfpipe.scenes.formfactors import DenseFormFactors, FormFactors, facing_pairs, form_factors
from rfpipe.scenes.geometry import SurfacePoints
from rfpipe.scenes.occluders import Occluder, blocked

__all__ = ["DENSE_RAYS", "RadiosityScene"]

DENSE_RAYS = 8192  # rays above which a dense matrix is refused: it would take over half a gigabyte


class RadiosityScene:
    """Diffuse planes, their albedo and black occluders, seen by a coaxial rig.

    Parameters
    ----------
    points
        The surface points behind the pixels.
    albedo
        (H, W, C) in [0, 1): C is 1 (grey) or 3 (RGB). Pixels that see an occluder get 0.
    bounces
        Light simulated: 1 is direct light alone, each further one adds an inter-reflection.
    occluders
        Black parallelograms that block light between points and the rig's own view.
    compress
        Whether to compress the form factors; None decides by their number.
    name
        What the scene is called in its description.

    Raises
    ------
    InputError
        If albedo or bounces are out of range.
    """

    def __init__(
        self,
        points: SurfacePoints,
        albedo: ArrayLike,
        *,
        bounces: int = 3,
        occluders: Sequence[Occluder] = (),
        compress: bool | None = None,
        name: str = "radiosity",
    ) -> None:
        values = np.array(albedo, dtype=np.float64)
        if values.shape[:2] != points.shape or values.ndim != 3:
            raise InputError(
                f"albedo of shape {values.shape}: expected ({', '.join(map(str, points.shape))}, "
                "channels)"
            )
        if not ((values >= 0) & (values < 1)).all():
            raise InputError("albedo: every value should be at least 0 and below 1")
        if bounces < 1:
            raise InputError(f"bounces {bounces}: expected at least 1, the direct light")
        self.points = points
        self.occluders = tuple(occluders)
        self.bounces = bounces
        self.name = name
        self._compress = compress
        origin = np.zeros(3)
        for occluder in self.occluders:
            seen = blocked(occluder.coordinates(origin), occluder.coordinates(points.positions))
            values[seen.reshape(points.shape)] = 0
        self._albedo = values.reshape(-1, values.shape[2])

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the ray domain."""
        return self.points.shape

    @property
    def channels(self) -> int:
        """Colour channels, 1 or 3."""
        return self._albedo.shape[1]

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Albedo (H, W, C) in [0, 1), float32; 0 where the rig sees an occluder."""
        return self._albedo.reshape(*self.shape, self.channels).astype(np.float32)

    @cached_property
    def form_factors(self) -> FormFactors:
        """The operator G, built when it is first used."""
        return form_factors(self.points, self.occluders, compress=self._compress)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance under projected patterns.

        A pattern's radiance doesn't depend on the patterns beside it, see `apply_in_batches`.

        Parameters
        ----------
        patterns
            (B, N) or (B, H, W): weights of the rays, in image order.

        Returns
        -------
        float32 (B, N, C)
            In units in which direct light is albedo x mean(A) / A.

        Raises
        ------
        InputError
            If the patterns don't have N rays each.
        """
        return apply_in_batches(self._radiance, patterns, self.shape, self.channels)

    def _radiance(self, weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radiance (N, B, C) of patterns (N, B)."""
        albedo, areas = self._albedo[:, None, :], self.points.areas[:, None, None]
        reflected = weights[..., None] * albedo  # leaves a point, per unit of its area
        total = reflected / areas
        for _ in range(1, self.bounces):
            columns = reflected.reshape(len(weights), -1)
            received = self.form_factors.apply(columns).reshape(reflected.shape)
            received *= albedo
            total += received
            reflected = received * areas
        total *= self.points.mean_area
        return total

    def dense(self, channel: int = 0) -> NDArray[np.float64]:
        """The whole matrix of one channel, exact and exactly symmetric.

        Parameters
        ----------
        channel
            Colour channel, from 0.

        Returns
        -------
        float64 (N, N)

        Raises
        ------
        InputError
            Above `DENSE_RAYS` rays, or for a channel that doesn't exist.
        """
        rays = len(self._albedo)
        if rays > DENSE_RAYS:
            raise InputError(
                f"a dense matrix of {rays} rays would take {8e-9 * rays**2:.1f} GB; dense() is for "
                f"at most {DENSE_RAYS} rays, apply() for any number"
            )
        if not 0 <= channel < self.channels:
            raise InputError(f"channel {channel}: expected 0 to {self.channels - 1}")
        albedo, areas = self._albedo[:, channel], self.points.areas
        transport = np.diag(albedo / areas)
        if self.bounces > 1:
            geometry = np.zeros((rays, rays))
            for first, second, block in DenseFormFactors(
                facing_pairs(self.points, self.occluders)
            ).blocks:
                geometry[np.ix_(first, second)] = block
                geometry[np.ix_(second, first)] = block.T
            bounce = np.outer(albedo, albedo) * geometry
            transport += bounce
            for _ in range(2, self.bounces):
                bounce = (albedo[:, None] * geometry * areas) @ bounce
                transport += (bounce + bounce.T) / 2  # products round: symmetric by rounding alone
        transport *= self.points.mean_area
        return transport

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            "scene": self.name,
            "shape": list(self.shape),
            "channels": self.channels,
            "planes": [asdict(plane) for plane in self.points.planes],
            "albedo": fingerprint(self._albedo),
            "bounces": self.bounces,
            "occluders": [asdict(occluder) for occluder in self.occluders],
            "compress": self._compress,
        }
