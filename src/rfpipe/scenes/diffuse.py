"""Light that bounces between diffuse surface points.

With r the albedo, A the points' areas and G the form factors between them, flux f on the points
leaves them as radiosity ``(diag(r / A) + diag(r) G diag(r) + diag(r) G diag(r A) G diag(r) + ...)
f``: direct light, second bounce, third bounce. The matrix is symmetric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.scenes.facing import facing_pairs
from rfpipe.scenes.formfactors import DenseFormFactors, FormFactors, form_factors
from rfpipe.scenes.geometry import Points
from rfpipe.scenes.occluders import Occluder

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["DENSE_POINTS", "DiffuseSurfaces", "Patches", "require_channel", "require_few"]

DENSE_POINTS = 8192  # above which a dense matrix is refused: it would take over half a gigabyte


@dataclass(frozen=True)
class Patches:
    """Neighbouring points taken together, for light that comes from afar and varies slowly.

    Parameters
    ----------
    points
        The patches, each as a point.
    of_point
        int64 (N,): the patch that each of the N finer points belongs to.
    """

    points: Points
    of_point: NDArray[np.int64]

    def spread(self, factors: FormFactors) -> FormFactors:
        """The form factors between the finer points: those of their patches."""
        return _SpreadFormFactors(factors, self.of_point, len(self.points.areas))


class _SpreadFormFactors:
    """G between points, each as it is between the points' patches."""

    def __init__(self, factors: FormFactors, patch: NDArray[np.int64], patches: int) -> None:
        self._factors = factors
        self._patch = patch
        self._patches = patches

    @property
    def nbytes(self) -> int:
        """Bytes of the patches' form factors."""
        return self._factors.nbytes

    @cached_property
    def _sums(self) -> csr_array[np.float64]:
        """The matrix (patches, N) that adds up the points of each patch."""
        from scipy.sparse import csr_array

        points = np.arange(len(self._patch))
        ones = np.ones(len(points))
        return csr_array((ones, (self._patch, points)), shape=(self._patches, len(points)))

    def apply(self, columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Multiply G with columns (N, K), float64 in and out."""
        return self._factors.apply(np.asarray(self._sums @ columns))[self._patch]


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
        points = self.points if self.patches is None else self.patches.points
        factors = form_factors(points, self.occluders, compress=self.compress)
        return factors if self.patches is None else self.patches.spread(factors)

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
        points = self.points if self.patches is None else self.patches.points
        geometry = np.zeros((len(points.areas), len(points.areas)))
        for first, second, block in DenseFormFactors(facing_pairs(points, self.occluders)).blocks:
            geometry[np.ix_(first, second)] = block
            geometry[np.ix_(second, first)] = block.T
        if self.patches is None:
            return geometry
        return geometry[np.ix_(self.patches.of_point, self.patches.of_point)]


def require_few(count: int, what: str) -> None:
    """Refuse a dense matrix that would be too large.

    Raises
    ------
    InputError
        Above `DENSE_POINTS`.
    """
    if count > DENSE_POINTS:
        raise InputError(
            f"a dense matrix of {count} {what} would take {8e-9 * count**2:.1f} GB; dense() is for "
            f"at most {DENSE_POINTS} {what}, apply() for any number"
        )


def require_channel(channel: int, channels: int) -> None:
    """Refuse a colour channel that doesn't exist, by an InputError."""
    if not 0 <= channel < channels:
        raise InputError(f"channel {channel}: expected 0 to {channels - 1}")
