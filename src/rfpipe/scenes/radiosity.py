"""Light that bounces between diffuse surface points, between a camera and a projector.

With r the albedo, A the points' areas and G the form factors between them, flux f on the points
leaves them as radiosity ``M f``, ``M = diag(r / A) + diag(r) G diag(r) + diag(r) G diag(r A) G
diag(r) + ...``: direct light, second bounce, third bounce. M is symmetric.

Of a coaxial rig a projector pixel sends its light onto one point and a camera pixel sees one:
``T = s M``, symmetric as eq. (2.10) wants it, s being the mean of the areas. Of other rigs a matrix
P says in what proportion rays see points, and one Q in what proportion rays light them:
``T = s P M Q``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import Scene, apply_in_batches
from rfpipe.scenes.formfactors import Index, facing_pairs
from rfpipe.scenes.sight import Points
from rfpipe.scenes.surfaces import Occluder

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from rfpipe.scenes.clusters import Compressed

Double = NDArray[np.float64]

DENSE_LIMIT = 2**25
"""Entries of G, each unordered pair of points counted once, above which it is compressed: a quarter
of a gigabyte of float64."""

DENSE_RAYS = 8192  # above which a dense matrix is refused: it would take over half a gigabyte
_COLUMNS_AT_A_TIME = 256  # of a dense matrix


class FormFactors:
    """The symmetric operator G on columns of surface points, with occluders between them.

    It is compressed, or not, as `compress` says; None decides by `DENSE_LIMIT`.
    """

    def __init__(
        self, points: Points, occluders: Sequence[Occluder] = (), *, compress: bool | None = None
    ) -> None:
        pairs = tuple(facing_pairs(points, occluders))
        self.blocks: list[tuple[tuple[Index, Index], Double | Compressed]] = []
        if compress is None:
            compress = sum(pair.size for pair in pairs) > DENSE_LIMIT
        if compress:
            from rfpipe.scenes.clusters import compressed  # brings in scipy

            self.blocks = [(pair.indices, compressed(pair)) for pair in pairs]
        else:
            self.blocks = [(pair.indices, pair.block()) for pair in pairs]

    def apply(self, columns: Double) -> Double:
        """Multiply G with columns (N, K), float64 in and out."""
        out = np.zeros_like(columns)
        for (first, second), block in self.blocks:
            out[first] += block @ columns[second]
            out[second] += block.T @ columns[first]
        return out


@dataclass(frozen=True)
class Rays:
    """Where a rig's rays meet the points of a scene.

    Parameters
    ----------
    camera_shape, projector_shape
        Shapes of the ray domains, of M and of N rays.
    seen
        Sparse (M, n): how much of each of the n points a camera ray sees.
    lit
        Sparse (n, N): how much of a projector ray's light each point gets; None where camera and
        projector share their rays, so that it is the transpose of `seen`.
    direct
        Sparse (M, N), one a channel: light that goes from the projector to the camera besides.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    seen: csr_array[np.float64]
    lit: csr_array[np.float64] | None = None
    direct: Sequence[csr_array[np.float64]] = ()

    @cached_property
    def spread(self) -> csr_array[np.float64]:
        """What spreads the projector's light over the points, (n, N)."""
        return self.seen.T.tocsr() if self.lit is None else self.lit


class RadiosityScene(Scene):
    """Diffuse surfaces, their albedo, and black occluders between them.

    Parameters
    ----------
    points
        The n surface points.
    albedo
        In [0, 1), (*camera_shape, C) where rays and points are the same, else (n, C): C is 1 (grey)
        or 3 (RGB).
    bounces
        Light simulated: 1 is direct light alone, each further one adds an inter-reflection.
    occluders
        Black parallelograms that block light between points.
    scale
        The factor s; None for the mean of the areas, which gives direct light of
        albedo x mean(A) / A.
    rays
        Where rays meet points; None for a coaxial rig of which each pixel has a point of its own.
    patches
        Neighbouring points taken together, each patch as a point, between which the form factors
        are taken, and the patch int64 (n,) that each point belongs to.
    name
        What the scene is called in its description.
    about
        What else shapes it, as plain data.

    Raises
    ------
    InputError
        If albedo is out of range.
    """

    def __init__(
        self,
        points: Points,
        albedo: ArrayLike,
        *,
        bounces: int = 3,
        occluders: Sequence[Occluder] = (),
        scale: float | None = None,
        rays: Rays | None = None,
        patches: tuple[Points, NDArray[np.int64]] | None = None,
        name: str = "radiosity",
        about: Mapping[str, Any] | None = None,
    ) -> None:
        values = np.array(albedo, dtype=np.float64)
        camera = values.shape[:-1] if rays is None else rays.camera_shape
        super().__init__(camera, camera if rays is None else rays.projector_shape, values.shape[-1])
        self._values = values.reshape(-1, self.channels)
        if not ((values >= 0) & (values < 1)).all():
            raise InputError("albedo: every value should be at least 0 and below 1")
        self.points, self.bounces, self.occluders = points, bounces, tuple(occluders)
        self.scale = points.mean_area if scale is None else scale
        self.rays, self._patches = rays, patches
        self.name, self._about = name, dict(about or {})

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Albedo float32 (*camera_shape, C) in [0, 1); 0 of an occluder."""
        albedo = self._values if self.rays is None else np.asarray(self.rays.seen @ self._values)
        return albedo.reshape(*self.camera_shape, self.channels).astype(np.float32)

    @cached_property
    def form_factors(self) -> FormFactors:
        """The operator G between points, or patches of them, built when it is first used."""
        points = self.points if self._patches is None else self._patches[0]
        return FormFactors(points, self.occluders)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape)."""
        rays = math.prod(self.camera_shape)
        return apply_in_batches(self._radiance, patterns, self.projector_shape, self.channels, rays)

    def _radiance(self, weights: Double, channels: slice = slice(None)) -> Double:
        """Radiance (M, B, C) of patterns (N, B), of some channels."""
        albedo = self._values[:, None, channels]
        if self.rays is None:
            return self._radiosity(weights, albedo)
        light = self._radiosity(np.asarray(self.rays.spread @ weights), albedo)
        radiance = np.asarray(self.rays.seen @ light.reshape(len(light), -1))
        radiance = radiance.reshape(-1, *light.shape[1:])
        for place, direct in enumerate(self.rays.direct[channels]):
            radiance[..., place] += direct @ weights
        return radiance

    def _radiosity(self, flux: Double, albedo: Double) -> Double:
        """Light that leaves points of albedo (n, 1, C) under flux (n, B): float64 (n, B, C)."""
        areas = self.points.areas[:, None, None]
        reflected = flux[..., None] * albedo  # leaves a point, per unit of its area
        total = reflected / areas
        for _ in range(1, self.bounces):
            columns = reflected.reshape(len(flux), -1)
            received = self._exchanged(columns).reshape(reflected.shape)
            received *= albedo
            total += received
            reflected = received * areas
        total *= self.scale
        return total

    @cached_property
    def _sums(self) -> csr_array[np.float64]:
        """The matrix that adds up the points of each patch."""
        from scipy.sparse import csr_array

        assert self._patches is not None
        count = np.arange(len(self._patches[1]))
        return csr_array((np.ones(len(count)), (self._patches[1], count)))

    def _exchanged(self, columns: Double) -> Double:
        """G times columns (n, K)."""
        if self._patches is None:
            return self.form_factors.apply(columns)
        return self.form_factors.apply(np.asarray(self._sums @ columns))[self._patches[1]]

    def dense(self, channel: int = 0) -> Double:
        """The whole matrix (M, N) of one channel; exactly symmetric, of a coaxial scene.

        Raises InputError above `DENSE_RAYS` rays.
        """
        count = max(math.prod(self.camera_shape), math.prod(self.projector_shape))
        if count > DENSE_RAYS:
            raise InputError(
                f"a dense matrix of {count} rays would take {8e-9 * count**2:.1f} GB; dense() is "
                f"for at most {DENSE_RAYS}, apply() for any number"
            )
        rays = np.eye(math.prod(self.projector_shape))
        columns = np.array_split(rays, 1 + len(rays) // _COLUMNS_AT_A_TIME, axis=1)
        part = slice(channel, channel + 1)
        matrix = np.concatenate([self._radiance(each, part)[..., 0] for each in columns], axis=1)
        coaxial = self.rays is None or self.rays.lit is None
        return (matrix + matrix.T) / 2 if coaxial else matrix  # products round

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            "scene": self.name,
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "surfaces": [asdict(surface) for surface in self.points.surfaces],
            "occluders": [asdict(occluder) for occluder in self.occluders],
            "albedo": fingerprint(self._values),
            "bounces": self.bounces,
            "scale": self.scale,
            **self._about,
        }
