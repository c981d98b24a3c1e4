"""Transport between rays of different domains: sparse direct light, and light between functions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.arrays import ArrayTransport, LazyArrays, runs_of
from rfpipe.transport.base import Float

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class FootprintTransport(ArrayTransport):
    """Transport ``T = D + diag(f) L S R^T diag(g)`` a channel, for any two ray domains.

    D are footprints: the few projector rays that light a camera ray directly. L and R are functions
    over the camera's and the projector's rays, S what they exchange, f and g the light that each
    ray takes and gives.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.arrays.HoldingTransport`.
    held : mapping of str to ndarray
        Sparse matrices row by row: row ``i`` of the matrix `name` is non-zero at the columns
        ``{name}_columns[{name}_starts[i] : {name}_starts[i + 1]]``, both int32. ``footprints`` is
        D, its values ``footprints``, float32 (channels, entries), in radiance; ``left`` L and
        ``right`` R, their values ``left`` and ``right``, float32 (entries,), unitless; ``cores``
        S, its values ``cores``, float32 (channels, entries), of any sign. ``camera_factor``,
        float32 (channels, camera rays), f, and ``projector_factor``, float32 (channels, projector
        rays), g: the product of f, S and g is radiance. They may be read lazily. Cores cancel, so
        that no store rounds them.
    """

    kind = "footprints"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, projector rays)``."""
        planes = []
        for k, c in enumerate(channels):
            light = patterns[:, k].T
            sent = self._right.T @ (light * self._held["projector_factor"][c][:, None])
            smooth = self._left @ (self._between("cores", c) @ sent)
            direct = self._between("footprints", c) @ light
            planes.append((direct + smooth * self._held["camera_factor"][c][:, None]).T)
        return np.ascontiguousarray(np.stack(planes, axis=1), np.float32)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, camera rays)``."""
        planes = []
        for k, c in enumerate(channels):
            light = images[:, k].T
            sent = self._left.T @ (light * self._held["camera_factor"][c][:, None])
            smooth = self._right @ (self._between("cores", c).T @ sent)
            direct = self._between("footprints", c).T @ light
            planes.append((direct + smooth * self._held["projector_factor"][c][:, None]).T)
        return np.ascontiguousarray(np.stack(planes, axis=1), np.float32)

    def between_some(self, seen: NDArray[np.bool_], lit: NDArray[np.bool_]) -> FootprintTransport:
        """Return what some rays see and take, see `Light.between_some`.

        The footprints are kept by the camera's rays: those of a part of the projector's are read
        with all others.
        """
        held = self._held
        wanted = {"footprints": seen, "left": seen, "right": lit}

        def read(name: str) -> NDArray[Any]:
            matrix, _, part = name.partition("_")
            if matrix not in wanted:
                return held[name]
            rows, starts = wanted[matrix], held[f"{matrix}_starts"].astype(np.int64)
            if part == "starts":
                return np.append(0, np.cumsum(np.diff(starts) * rows))
            return runs_of(held, name, np.stack([starts[:-1], starts[1:]], axis=1)[rows])

        return self._holding(self.level_rows, LazyArrays([*held], read))

    def direct(self) -> FootprintTransport:
        """Return the footprints alone."""
        dark = {name: np.zeros_like(self._held[name]) for name in ("cores", "camera_factor")}
        return self._holding(self.level_rows, {**self._held, **dark})

    @cached_property
    def _left(self) -> csr_array[np.float32]:
        return self._matrix("left", self._held["left"], len(self._held["cores_starts"]) - 1)

    @cached_property
    def _right(self) -> csr_array[np.float32]:
        last = (self._held[name].max(initial=-1) for name in ("right_columns", "cores_columns"))
        return self._matrix("right", self._held["right"], int(max(last)) + 1)

    def _between(self, name: str, channel: int) -> csr_array[np.float32]:
        """Return D or S of a channel."""
        rays = int(np.prod(self.projector_shape))
        size = rays if name == "footprints" else self._right.shape[1]
        return self._matrix(name, self._held[name][channel], size)

    def _matrix(self, name: str, values: Float, columns: int) -> csr_array[np.float32]:
        from scipy.sparse import csr_array

        starts: Any = self._held[f"{name}_starts"]
        shape = (len(starts) - 1, columns)
        return csr_array((values, self._held[f"{name}_columns"], starts), shape=shape)
