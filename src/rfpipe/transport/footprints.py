"""Light transport of any rig: sparse direct light, and smooth light between functions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.transport.array_transport import ArrayTransport
from rfpipe.transport.function_pairs import product_diagonal

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class FootprintTransport(ArrayTransport):
    """Transport ``T = D + diag(f) L S R^T diag(g)`` of each channel, for any two ray domains.

    D are footprints: the few projector rays that light a camera ray directly. L and R are smooth
    functions over the camera's and the projector's rays, the cores S the light between them, f and
    g scale factors of each ray, by which the smooth light has the texture of the scene. M, N, n and
    C are the numbers of camera rays, of projector rays, of functions and of channels.

    Parameters
    ----------
    camera_shape, projector_shape, channels, level_rows, nbytes
        See `rfpipe.transport.base.Transport`.
    content : mapping of str to ndarray
        The arrays below; they may be read lazily. Row i of a sparse matrix has its entries in the
        columns ``{name}_columns[{name}_starts[i] : {name}_starts[i + 1]]``, both int32. Stores keep
        them in full float32: the terms of cores of opposite sign are large and nearly cancel, so
        that rounding them would leave large errors.

    Notes
    -----
    ======  ====================  ===============  =================================================
    symbol  array                 values, float32  meaning and unit
    ======  ====================  ===============  =================================================
    ``D``   ``footprints``        (C, entries)     sparse (M, N), radiance
    ``L``   ``left``              (entries,)       sparse (M, n), no unit
    ``R``   ``right``             (entries,)       sparse (N, n), no unit
    ``S``   ``cores``             (C, entries)     sparse (n, n), of any sign
    ``f``   ``camera_factor``     (C, M)           scale factor; the product of f, S and g is
                                                   radiance
    ``g``   ``projector_factor``  (C, N)           scale factor
    ======  ====================  ===============  =================================================

    D, L, R and S are sparse: *entries* is the number of entries of that matrix, which all channels
    have in the same places.
    """

    kind = "footprints"

    def _forward(self, light: Float, channel: int) -> Any:
        D, S, f, g = self._of_channel(channel)
        smooth = self._L @ (S @ (self._R.T @ (light.T * g[:, None])))
        return (D @ light.T + smooth * f[:, None]).T

    def _adjoint(self, light: Float, channel: int) -> Any:
        D, S, f, g = self._of_channel(channel)
        smooth = self._R @ (S.T @ (self._L.T @ (light.T * f[:, None])))
        return (D.T @ light.T + smooth * g[:, None]).T

    def relight_per_ray(self, patterns: Any, channel: int) -> Float:
        """Return each ray under its own pattern, see `MatrixAlgebra.relight_per_ray`."""
        D, S, f, g = self._of_channel(channel)
        smooth = f * product_diagonal(self._L, S, patterns.multiply(g) @ self._R)
        radiance: Float = patterns.multiply(D).sum(axis=1) + smooth
        return radiance

    def direct(self) -> FootprintTransport:
        """Return the transport of direct light, D."""
        dark = {name: np.zeros_like(self._content[name]) for name in ("cores", "camera_factor")}
        return self.with_content(self.level_rows, {**self._content, **dark})

    def mixed_with_even_light(
        self, smooth: Sequence[float], even: Sequence[float]
    ) -> FootprintTransport:
        """Return ``D + diag(f) (smooth L S R^T + even 1 1^T) diag(g)``: a mixture with even light.

        Smooth light of cores of any sign is negative for some patterns if few pictures determine
        it. A mixture with even light is not; `rfpipe.fitting.footprints` needs it.

        Parameters
        ----------
        smooth, even : sequence of float
            Share of the smooth light, from 0 to 1, and strength of the even light, at least 0, of
            each channel.
        """
        from scipy.sparse import block_array, csr_array, hstack

        functions = []
        for matrix in (self._L, self._R):
            ones: Any = csr_array(np.ones((matrix.shape[0], 1), np.float32))
            functions.append(csr_array(hstack([matrix, ones])))
        cores = []
        for channel, (share, strength) in enumerate(zip(smooth, even, strict=True)):
            S = np.float32(share) * self._matrix("cores", self._content["cores"][channel])
            constant = csr_array(np.full((1, 1), strength, np.float32))
            cores.append(csr_array(block_array([[S, None], [None, constant]])))
        arrays = {
            **self._content,
            **sparse_arrays("left", functions[0]),
            **sparse_arrays("right", functions[1]),
            **sparse_arrays("cores", cores[0], [core.data for core in cores]),
        }
        return self.with_content(self.level_rows, arrays)

    def _of_channel(
        self, channel: int
    ) -> tuple[csr_array[np.float32], csr_array[np.float32], Float, Float]:
        """Return D, S, f and g."""
        arrays = self._content
        return (
            self._matrix("footprints", arrays["footprints"][channel]),
            self._matrix("cores", arrays["cores"][channel]),
            arrays["camera_factor"][channel],
            arrays["projector_factor"][channel],
        )

    @cached_property
    def _L(self) -> csr_array[np.float32]:  # noqa: N802
        return self._matrix("left", self._content["left"])

    @cached_property
    def _R(self) -> csr_array[np.float32]:  # noqa: N802
        return self._matrix("right", self._content["right"])

    @cached_property
    def _column_counts(self) -> dict[str, int]:
        """Number of columns of each sparse matrix."""
        last = [self._content[name].max(initial=-1) for name in ("right_columns", "cores_columns")]
        functions = int(max(last)) + 1
        return {
            "footprints": int(np.prod(self.projector_shape)),
            "cores": functions,
            "left": len(self._content["cores_starts"]) - 1,
            "right": functions,
        }

    def _matrix(self, name: str, values: Float) -> csr_array[np.float32]:
        from scipy.sparse import csr_array

        starts: Any = self._content[f"{name}_starts"]
        shape = (len(starts) - 1, self._column_counts[name])
        return csr_array((values, self._content[f"{name}_columns"], starts), shape=shape)


def sparse_arrays(
    name: str, matrix: csr_array[Any], values: list[Float] | None = None
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a sparse matrix in a `FootprintTransport`.

    Parameters
    ----------
    name : str
    matrix : csr_array
    values : list of ndarray of float32, optional
        Entries of each channel, in the order of the matrix's. Entries that are 0 in all channels
        are dropped. By default the matrix's own, for all channels.
    """
    channels = [matrix.data] if values is None else values
    used = np.zeros(matrix.nnz, np.bool_)
    for entries in channels:
        used |= entries != 0
    before = np.concatenate([[0], np.cumsum(used)])
    kept = np.stack([entries[used].astype(np.float32, copy=False) for entries in channels])
    return {
        name: kept[0] if values is None else kept,
        f"{name}_columns": matrix.indices[used].astype(np.int32),
        f"{name}_starts": before[matrix.indptr].astype(np.int32),
    }
