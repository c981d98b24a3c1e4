"""Radiosity: direct light and inter-reflection between diffuse surface points.

For the albedo r, the points' areas A and the form factors G, flux f on the points leads to the
radiosity ``M f``, with ``M = diag(r / A) + diag(r) G diag(r) + diag(r) G diag(r A) G diag(r) +
...``: direct light, second bounce, third bounce. M is symmetric.

On a coaxial rig with a point per pixel, ``T = s M``, which is symmetric (2.10); s is the mean area.
In general, a matrix P has the weights with which camera rays see points, and Q those with which
projector rays light points: ``T = s P M Q``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.array_types import Double, Index
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import Scene, apply_in_batches
from rfpipe.scenes.formfactors import facing_pairs
from rfpipe.scenes.pinholes import Pinhole, Points
from rfpipe.scenes.surfaces import Occluder

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from rfpipe.scenes.clusters import Compressed


DENSE_LIMIT = 2**25
"""Largest number of entries (unordered pairs of points) of a dense G: 256 MB of float64."""

DENSE_RAYS = 8192  # maximum for a dense matrix, which then has half a gigabyte
_COLUMNS_AT_A_TIME = 256  # columns of a dense matrix computed at a time


class FormFactors:
    """The symmetric operator G on values at surface points, with occlusion.

    `compress` selects compressed or dense blocks; None: by `DENSE_LIMIT`.
    """

    def __init__(
        self, points: Points, occluders: Sequence[Occluder] = (), *, compress: bool | None = None
    ) -> None:
        pairs = tuple(facing_pairs(points, occluders))
        self.blocks: list[tuple[tuple[Index, Index], Double | Compressed]] = []
        if compress is None:
            compress = sum(pair.size for pair in pairs) > DENSE_LIMIT
        if compress:
            from rfpipe.scenes.clusters import compress_block  # imports scipy

            self.blocks = [(pair.indices, compress_block(pair)) for pair in pairs]
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
    """Weights between a rig's rays and the points of a scene.

    Parameters
    ----------
    camera_shape, projector_shape
        Shapes of the ray domains, of M and of N rays.
    visibility
        Sparse (M, n): weights of the n points in each camera ray.
    lit
        Sparse (n, N): fraction of each projector ray's light on each point; None for a coaxial rig,
        where it is the transpose of `visibility`.
    direct
        Sparse (M, N), one per channel: additional transport of direct light.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    visibility: csr_array[np.float64]
    lit: csr_array[np.float64] | None = None
    direct: Sequence[csr_array[np.float64]] = ()

    @cached_property
    def illumination(self) -> csr_array[np.float64]:
        """Matrix (n, N) that distributes the projector's light to the points."""
        return self.visibility.T.tocsr() if self.lit is None else self.lit


class RadiosityScene(Scene):
    """Diffuse surfaces with albedo, and black occluders between them.

    Parameters
    ----------
    points
        The n surface points.
    albedo
        In [0, 1): (*camera_shape, C) without `rays`, else (n, C); C is 1 (grey) or 3 (RGB).
    bounces
        Number of reflections: 1 is direct light only, each further one adds inter-reflection.
    occluders
        Black parallelograms that block light between points.
    scale
        The factor s; None: the mean area, so that direct light is albedo x mean(A) / A.
    rays
        Weights between rays and points; None for a coaxial rig with a point per pixel.
    patches
        Patches of neighbouring points, as points, between which indirect light is computed, and
        the patch int64 (n,) of each point.
    name
        Name in the description.
    about
        Further properties for the description, as plain data.
    pinholes
        Pinholes of the camera's views, if known.

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
        pinholes: Sequence[Pinhole] = (),
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
        self.pinholes = tuple(pinholes)
        self.name, self._about = name, dict(about or {})

    @property
    def albedo(self) -> NDArray[np.float32]:
        """Albedo float32 (*camera_shape, C) in [0, 1); 0 for occluders."""
        albedo = (
            self._values if self.rays is None else np.asarray(self.rays.visibility @ self._values)
        )
        return albedo.reshape(*self.camera_shape, self.channels).astype(np.float32)

    @cached_property
    def form_factors(self) -> FormFactors:
        """The operator G between points or patches, computed at the first access."""
        points = self.points if self._patches is None else self._patches[0]
        return FormFactors(points, self.occluders)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape)."""
        rays = math.prod(self.camera_shape)
        return apply_in_batches(self._radiance, patterns, self.projector_shape, self.channels, rays)

    def _radiance(self, weights: Double, channels: slice = slice(None)) -> Double:
        """Radiance (M, B, C) under patterns (N, B), for a slice of channels."""
        albedo = self._values[:, None, channels]
        if self.rays is None:
            return self._radiosity(weights, albedo)
        light = self._radiosity(np.asarray(self.rays.illumination @ weights), albedo)
        radiance = np.asarray(self.rays.visibility @ light.reshape(len(light), -1))
        radiance = radiance.reshape(-1, *light.shape[1:])
        for channel, direct in enumerate(self.rays.direct[channels]):
            radiance[..., channel] += direct @ weights
        return radiance

    def _radiosity(self, flux: Double, albedo: Double) -> Double:
        """Radiosity (n, B, C) of points with albedo (n, 1, C) under flux (n, B)."""
        areas = self.points.areas[:, None, None]
        reflected = flux[..., None] * albedo  # radiosity times the point's area
        total = reflected / areas
        for _ in range(1, self.bounces):
            columns = reflected.reshape(len(flux), -1)
            received = self._apply_form_factors(columns).reshape(reflected.shape)
            received *= albedo
            total += received
            reflected = received * areas
        total *= self.scale
        return total

    @cached_property
    def _sums(self) -> csr_array[np.float64]:
        """Matrix that sums over the points of each patch."""
        from scipy.sparse import csr_array

        assert self._patches is not None
        points = np.arange(len(self._patches[1]))
        return csr_array((np.ones(len(points)), (self._patches[1], points)))

    def _apply_form_factors(self, columns: Double) -> Double:
        """Multiply G with columns (n, K)."""
        if self._patches is None:
            return self.form_factors.apply(columns)
        return self.form_factors.apply(np.asarray(self._sums @ columns))[self._patches[1]]

    def dense(self, channel: int = 0) -> Double:
        """The full matrix (M, N) of one channel, exactly symmetric for a coaxial scene.

        Raises InputError above `DENSE_RAYS` rays.
        """
        count = max(math.prod(self.camera_shape), math.prod(self.projector_shape))
        if count > DENSE_RAYS:
            raise InputError(
                f"a dense matrix of {count} rays has {8e-9 * count**2:.1f} GB; dense() is limited "
                f"to {DENSE_RAYS} rays: use apply()"
            )
        rays = np.eye(math.prod(self.projector_shape))
        columns = np.array_split(rays, 1 + len(rays) // _COLUMNS_AT_A_TIME, axis=1)
        part = slice(channel, channel + 1)
        matrix = np.concatenate([self._radiance(batch, part)[..., 0] for batch in columns], axis=1)
        coaxial = self.rays is None or self.rays.lit is None
        return (matrix + matrix.T) / 2 if coaxial else matrix  # removes rounding errors

    def describe(self) -> dict[str, Any]:
        """Plain data of everything that determines the transport, for fingerprints (JSON)."""
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
