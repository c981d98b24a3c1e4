"""Transport between rays of different domains: sparse direct light, and light between functions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.transport.array_transport import ArrayTransport
from rfpipe.transport.base import Float
from rfpipe.transport.function_pairs import product_diagonal

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
        See `rfpipe.transport.base.Transport`.
    content : mapping of str to ndarray
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

    def _forward(self, light: Float, channel: int) -> Any:
        held, functions = self._content, self._functions
        cores, direct = (self._matrix(n, held[n][channel]) for n in ("cores", "footprints"))
        sent = functions["right"].T @ (light.T * held["projector_factor"][channel][:, None])
        smooth = functions["left"] @ (cores @ sent)
        return (direct @ light.T + smooth * held["camera_factor"][channel][:, None]).T

    def _adjoint(self, light: Float, channel: int) -> Any:
        held, functions = self._content, self._functions
        cores, direct = (self._matrix(n, held[n][channel]) for n in ("cores", "footprints"))
        sent = functions["left"].T @ (light.T * held["camera_factor"][channel][:, None])
        smooth = functions["right"] @ (cores.T @ sent)
        return (direct.T @ light.T + smooth * held["projector_factor"][channel][:, None]).T

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return what each ray sees under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        held, functions = self._content, self._functions
        cores, direct = (self._matrix(n, held[n][channel]) for n in ("cores", "footprints"))
        light = patterns.multiply(held["projector_factor"][channel]) @ functions["right"]
        smooth = held["camera_factor"][channel] * product_diagonal(functions["left"], cores, light)
        seen: Float = patterns.multiply(direct).sum(axis=1) + smooth
        return seen

    def direct(self) -> FootprintTransport:
        """Return the footprints alone."""
        dark = {name: np.zeros_like(self._content[name]) for name in ("cores", "camera_factor")}
        return self.with_content(self.level_rows, {**self._content, **dark})

    def mixed_with_even_light(
        self, smooth: Sequence[float], even: Sequence[float]
    ) -> FootprintTransport:
        """Return ``D + f (a L S R^T + b 1 1^T) g``: less smooth light, and light that is even.

        Parameters
        ----------
        smooth, even : sequence of float, length channels
            a, from 0 to 1, and b, at least 0, of each channel.
        """
        from scipy.sparse import block_array, csr_array, hstack

        functions = []
        for matrix in self._functions.values():
            ones: Any = csr_array(np.ones((matrix.shape[0], 1), np.float32))
            functions.append(csr_array(hstack([matrix, ones])))
        cores = [
            csr_array(
                block_array(
                    [
                        [np.float32(a) * self._matrix("cores", self._content["cores"][k]), None],
                        [None, csr_array(np.full((1, 1), b, np.float32))],
                    ]
                )
            )
            for k, (a, b) in enumerate(zip(smooth, even, strict=True))
        ]
        arrays = {
            **self._content,
            **sparse_arrays("left", functions[0]),
            **sparse_arrays("right", functions[1]),
            **sparse_arrays("cores", cores[0], [core.data for core in cores]),
        }
        return self.with_content(self.level_rows, arrays)

    @cached_property
    def _functions(self) -> dict[str, csr_array[np.float32]]:
        """L and R."""
        return {name: self._matrix(name, self._content[name]) for name in ("left", "right")}

    @cached_property
    def _columns(self) -> dict[str, int]:
        """How many columns the matrices have."""
        last = [self._content[name].max(initial=-1) for name in ("right_columns", "cores_columns")]
        of_right = int(max(last)) + 1
        of_left = len(self._content["cores_starts"]) - 1
        rays = int(np.prod(self.projector_shape))
        return {"footprints": rays, "cores": of_right, "left": of_left, "right": of_right}

    def _matrix(self, name: str, values: Float) -> csr_array[np.float32]:
        from scipy.sparse import csr_array

        starts: Any = self._content[f"{name}_starts"]
        shape = (len(starts) - 1, self._columns[name])
        return csr_array((values, self._content[f"{name}_columns"], starts), shape=shape)


def sparse_arrays(
    name: str, matrix: csr_array[Any], values: list[Float] | None = None
) -> dict[str, NDArray[Any]]:
    """Return a sparse matrix, values channel by channel, as a `FootprintTransport` holds it."""
    held = matrix.data.astype(np.float32) if values is None else np.stack(values)
    used = np.atleast_2d(held).any(axis=0)
    before = np.concatenate([[0], np.cumsum(used)])
    return {
        name: np.ascontiguousarray(held[..., used]),
        f"{name}_columns": matrix.indices[used].astype(np.int32),
        f"{name}_starts": before[matrix.indptr].astype(np.int32),
    }
