"""Relighting, and the analyses of a scene that are based on it.

A transport, its dual and selections of their rays share this interface.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.array_types import Bools, Float
from rfpipe.errors import InputError
from rfpipe.installation import needing
from rfpipe.ranges import ranges
from rfpipe.transport.algebra import MatrixAlgebra, RaySelection, selected_rays
from rfpipe.weights import as_weights

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator
    from xarray import DataArray

    from rfpipe.transport.compensation import Compensation
    from rfpipe.transport.correspondence import Correspondence
    from rfpipe.transport.light_interpolation import LightInterpolation
    from rfpipe.transport.normals import Normals
    from rfpipe.transport.separation import Separation

_BATCH_BYTES = 128 * 2**20
"""Memory of the images that are relit at a time, or of their patterns."""

LIMIT = 8 * 2**30
"""Default limit of the bytes of a matrix in a file, before compression."""


class Relightable(MatrixAlgebra):
    """Light transport that can be relit: a transport, its dual, or its restriction to some rays."""

    _lights: Float | None = None
    _interpolation: LightInterpolation | None = None
    _noise: Float | None = None

    @property
    def T(self) -> Relightable:  # noqa: N802 - as in scipy and numpy
        """The dual transport: from the camera's rays to the projector's (eq. 2.12)."""
        return TransposedTransport(self)

    @property
    def lights(self) -> Float | None:
        """Directions of the lights of each projector ray, float32 (rays, 3), or None.

        They are set where each projector ray is a separate, distant lamp instead of a projector
        pixel, as in a light stage or reflectance transformation imaging (RTI).
        Setting it raises InputError unless each ray has a direction.
        """
        return self._lights

    @lights.setter
    def lights(self, lights: ArrayLike | None) -> None:
        from rfpipe.environment import as_directions

        self._lights = None if lights is None else as_directions(lights, count=self.shape[2])
        self._interpolation = None

    @property
    def noise(self) -> Float | None:
        """Standard deviation of one picture, float32 (*camera_shape), or None.

        In radiance, for the sum of the channels; infinite at camera pixels that no picture shows.
        Setting it raises InputError for another shape, NaN or negative values.
        """
        return self._noise

    @noise.setter
    def noise(self, noise: ArrayLike | None) -> None:
        self._noise = None if noise is None else _check_noise(noise, self.camera_shape)

    def relight(self, pattern: NDArray[Any]) -> Float:
        """Return the image under a pattern, ``c = T p`` (eq. 2.11).

        Parameters
        ----------
        pattern : array, shape (*projector_shape) or (*projector_shape, channels)
            Any finite real weights; without a channel axis the light is white.

        Returns
        -------
        ndarray of float32, shape (*camera_shape, channels)

        Raises
        ------
        InputError
            If the pattern has another shape or is not finite.
        """
        image: Float = self.relight_batch(np.asarray(pattern)[None])[0]
        return image

    def relight_batch(self, patterns: NDArray[Any]) -> Float:
        """Relight with several patterns ``(P, *projector_shape[, channels])`` at once."""
        planar = planar_patterns(patterns, self.projector_shape, self.channels)
        rays = prod(self.camera_shape)
        images = np.empty((len(planar), rays, self.channels), np.float32)
        largest = self.channels * max(rays, planar.shape[-1]) * images.itemsize
        for first, last in ranges(len(planar), max(1, _BATCH_BYTES // largest)):
            batch = self.forward(planar[first:last], range(self.channels))
            images[first:last] = np.moveaxis(batch, 1, -1)
        return images.reshape(len(planar), *self.camera_shape, self.channels)

    def correspondence(self) -> Correspondence:
        """Locate the projector pixel that lights each camera pixel directly.

        Returns places to a fraction of a pixel, their confidence and a mask; see
        `rfpipe.transport.correspondence`. InputError for a projector of several views.
        """
        from rfpipe.transport.correspondence import correspondence_of

        return correspondence_of(self, self.noise)

    def light_from(self, direction: ArrayLike) -> Float:
        """Return the picture under one light from any direction, interpolated between lights.

        At a light's direction it is that light's picture. Elsewhere the pictures of the lights are
        interpolated, see `rfpipe.lights.interpolation`.

        Parameters
        ----------
        direction : array, shape (3,)
            From the scene to the light, of any length.

        Returns
        -------
        ndarray of float32, shape (*camera_shape, channels)
            Radiance, 0 or more; 0 if the direction is farther from all lights than twice their
            spacing.

        Raises
        ------
        InputError
            If the direction is 0 or not finite, or the lights' directions are unknown.
        """
        from rfpipe.environment import Sky, as_directions
        from rfpipe.lights.interpolation import unit

        towards = unit(as_directions(np.asarray(direction, np.float32)[None], "direction"))
        sky = Sky(towards, np.ones((1, self.channels)))
        return self.light_interpolation().relight(self, sky)

    def relight_environment(
        self,
        environment: ArrayLike,
        lights: ArrayLike | None = None,
        turned: float = 0.0,
        mirrored: bool = False,
    ) -> Float:
        """Return the picture under a panorama, for a transport whose rays are single lights.

        It is the sum of `light_from` over the directions of the panorama. Directions far from all
        lights are left out; `rfpipe.environment_coverage` is the share of light that remains.

        Parameters
        ----------
        environment, turned, mirrored
            See `rfpipe.environment_weights`.
        lights : array, shape (lights, 3), optional
            Directions, one for each ray; by default `lights` of the transport.

        Returns
        -------
        ndarray of float32, shape (*camera_shape, channels)
            In colour if the transport or the panorama is.

        Raises
        ------
        InputError
            As `rfpipe.environment_weights`, and if the directions of the lights are unknown or
            their number differs from the number of projector rays.
        """
        from rfpipe.environment import sky_of

        sky = sky_of(environment, turned, mirrored)
        return self.light_interpolation(lights).relight(self, sky)

    def light_interpolation(self, lights: ArrayLike | None = None) -> LightInterpolation:
        """Return the interpolation between lights, by default the transport's, computed once.

        InputError if the directions of the lights are unknown.
        """
        from rfpipe.environment import as_directions
        from rfpipe.transport.light_interpolation import interpolate_lights

        if lights is not None:
            return interpolate_lights(self, as_directions(lights, count=self.shape[2]))
        if self.lights is None:
            raise InputError(
                "the transport has no directions of its lights; fit it from a folder with a file "
                "of their directions, or set transport.lights, one direction for each ray"
            )
        if self._interpolation is None:
            self._interpolation = interpolate_lights(self, self.lights)
        return self._interpolation

    def normals(self) -> Normals:
        """Estimate surface normals and albedo by photometric stereo, from one light at a time.

        See `rfpipe.transport.normals`. InputError if the lights' directions are unknown, or fewer
        than three.
        """
        from rfpipe.transport.normals import normals_of

        return normals_of(self, self.lights)

    def pattern_for(self, picture: NDArray[Any]) -> Compensation:
        """Compute the pattern, of weights 0 to 1, under which the scene looks like a picture.

        Parameters
        ----------
        picture : array, shape (*camera_shape) or (*camera_shape, channels)
            Radiance, 0 or more, in the unit of the transport's pictures.

        Raises
        ------
        InputError
            If the picture has another shape, negative or non-finite values, or integers; if no
            camera pixel receives light.
        """
        from rfpipe.transport.compensation import compensation_for

        target = planar_patterns(
            np.asarray(picture)[None], self.camera_shape, self.channels, "the picture"
        )
        return compensation_for(self, target[0])

    def separate(
        self, pattern: NDArray[Any], *, direct: int = 2, near: float = 1 / 16
    ) -> Separation:
        """Divide the picture under a pattern into direct, near-range and far-range light.

        The range of light is the distance, in the projector's picture, between the ray that sent it
        and the ray that lights the camera pixel directly: the pixel itself on a coaxial rig, else
        the place from `correspondence`. Pixels without direct light take the place of the nearest
        pixel that has one.

        Parameters
        ----------
        pattern
            As for `relight`.
        direct : int
            Rows and columns of the projector up to which light is direct, 0 or more. Two include
            the width of a camera pixel and some blur.
        near : float
            Range up to which indirect light is near, as a share of the projector's longer side,
            above 0. The limit is gradual: half of the light at that range counts as near. The
            default is about the range of the near part of the method `near_far`.

        Raises
        ------
        InputError
            If the pattern has another shape or isn't finite, an option is out of range, no camera
            pixel receives light, or the projector's rays are several views or separate `lights`.
        """
        from rfpipe.transport.separation import separated

        light = planar_patterns(np.asarray(pattern)[None], self.projector_shape, self.channels)
        return separated(self, light[0], direct, near, self.noise)

    def restricted(self, camera_rays: Bools, projector_rays: Bools) -> Relightable:  # noqa: ARG002
        """Return a transport with the same entries between some camera and some projector rays.

        Both selections are bool (rays,). Entries of other rays may be 0.
        """
        return self

    def channel(self, index: int) -> LinearOperator:
        """Return one channel's matrix, rows x columns, as a scipy ``LinearOperator``."""
        from scipy.sparse.linalg import LinearOperator

        if not 0 <= index < self.channels:
            raise InputError(f"channel {index} of a transport with channels 0..{self.channels - 1}")

        def columnwise(apply: Any) -> Any:
            def product(x: NDArray[Any]) -> Float:
                """Apply to a vector or to the columns of a matrix; scipy restores x's shape."""
                columns = as_weights(x, "the vector").reshape(len(x), -1)
                planar = np.ascontiguousarray(columns.T[:, None], np.float32)
                image: Float = apply(planar, [index])[:, 0].T
                return image

            return product

        forward, adjoint = columnwise(self.forward), columnwise(self.adjoint)
        return LinearOperator(
            shape=self.shape[1:],
            matvec=forward,
            rmatvec=adjoint,
            matmat=forward,
            rmatmat=adjoint,
            dtype=np.dtype(np.float32),
        )

    def to_xarray(self, rows: RaySelection = None, columns: RaySelection = None) -> DataArray:
        """Return the matrix, or some rows and columns of it as `toarray`, labelled by its rays.

        Returns
        -------
        xarray.DataArray of float32, dims (channel, camera, projector)
            Ray numbers are the coordinates; ``camera_shape`` and ``projector_shape`` attributes.

        Raises
        ------
        InputError
            As `toarray`, and where xarray isn't installed.
        """
        with needing("xarray", "to_xarray"):
            from xarray import DataArray
        rays = {
            "camera": selected_rays(rows, self.camera_shape, "rows"),
            "projector": selected_rays(columns, self.projector_shape, "columns"),
        }
        attributes = {"camera_shape": self.camera_shape, "projector_shape": self.projector_shape}
        matrix = self.toarray(*rays.values())
        return DataArray(matrix, rays, ("channel", *rays), "radiance per weight", attributes)

    def save(
        self,
        path: str | Path,
        *,
        rows: RaySelection = None,
        columns: RaySelection = None,
        limit_bytes: int = LIMIT,
    ) -> None:
        """Write the matrix into a file, part by part, complete or not at all.

        Parameters
        ----------
        path : path
            Ends in ``.npz``, ``.h5``, ``.hdf5`` or ``.mat`` (v7.3), see docs/export.md. An existing
            file is replaced.
        rows, columns
            As in `toarray`.
        limit_bytes : int
            Bytes that the matrix may take before compression.

        Raises
        ------
        InputError
            If the name has another ending, a ray does not exist, or the matrix is larger.
        StoreError
            If the file can't be written, or the package for it isn't installed.
        """
        from rfpipe.transport.matrix_export import write_matrix

        write_matrix(self, Path(path), rows, columns, limit_bytes)


class TransposedTransport(Relightable):
    """Dual transport: from the camera's rays to the projector's (eq. 2.12)."""

    def __init__(self, primal: Relightable) -> None:
        self._primal = primal
        self.camera_shape = primal.projector_shape
        self.projector_shape = primal.camera_shape
        self.channels = primal.channels

    def __repr__(self) -> str:
        return f"{self._primal!r}.T"

    @property
    def T(self) -> Relightable:  # noqa: N802
        """The primal transport."""
        return self._primal

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar patterns ``(P, K, camera rays)``."""
        return self._primal.adjoint(patterns, channels)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar images ``(P, K, projector rays)``."""
        return self._primal.forward(images, channels)

    def restricted(self, camera_rays: Bools, projector_rays: Bools) -> Relightable:
        """Return a dual that is equal between some rays, see `Relightable.restricted`."""
        return self._primal.restricted(projector_rays, camera_rays).T


def planar_patterns(
    patterns: NDArray[Any], shape: tuple[int, ...], channels: int, name: str = "a pattern"
) -> Float:
    """Bring patterns ``(P, *shape[, channels])`` into planar form ``(P, channels, rays)``.

    All channels of white light share their memory.
    """
    patterns = as_weights(patterns, name)
    count = patterns.shape[0]
    if patterns.shape == (count, *shape):
        rays = np.ascontiguousarray(patterns, np.float32).reshape(count, 1, -1)
        planar = np.broadcast_to(rays, (count, channels, rays.shape[-1]))
    elif patterns.shape == (count, *shape, channels):
        planes = np.moveaxis(patterns.reshape(count, -1, channels), -1, 1)
        planar = np.ascontiguousarray(planes, np.float32)
    else:
        raise InputError(
            f"{name} has the shape {patterns.shape[1:]}; expected {shape} or {(*shape, channels)}"
        )
    if not np.isfinite(patterns).all():
        raise InputError(f"{name} has NaN or infinite weights; all weights must be finite")
    return planar


def _check_noise(noise: ArrayLike, camera_shape: tuple[int, ...]) -> Float:
    """Validate standard deviations of a picture; float32 (*camera_shape)."""
    deviations = np.asarray(noise, np.float32)
    if deviations.shape != tuple(camera_shape):
        raise InputError(
            f"noise has the shape {deviations.shape}; expected that of the camera's rays, "
            f"{tuple(camera_shape)}: one standard deviation for each"
        )
    if not (deviations >= 0).all():
        raise InputError("noise holds NaN or negative values; standard deviations are 0 or more")
    return deviations
