"""What every transport offers: relighting, its transpose, scipy linear operators, its levels."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, installing
from rfpipe.store.arrays import ArrayBundle, write_arrays
from rfpipe.transport.algebra import MatrixAlgebra, Rays, chosen_rays
from rfpipe.units import NumberFormat
from rfpipe.weights import as_weights

if TYPE_CHECKING:
    import pandas as pd
    from scipy.sparse import csr_array
    from scipy.sparse.linalg import LinearOperator
    from xarray import DataArray

    from rfpipe.transport.compensation import Compensation
    from rfpipe.transport.correspondence import Correspondence

Float = NDArray[np.float32]

LIMIT = 8 * 2**30
"""Bytes that a matrix in a file may take by default, before compression."""

HISTORY_COLUMNS = ("level", "patterns", "estimated_error", "estimated_indirect")
"""Level; patterns shown up to there, the floodlit one included; the error that the method then
estimated, relative to the norm of a relit image."""

_BATCH = 64


class Light(MatrixAlgebra):
    """What can be relit: a transport, its dual, or either between coarser rays."""

    @property
    def T(self) -> Light:  # noqa: N802 - as in scipy and numpy
        """The dual transport: from the camera's rays to the projector's (eq. 2.12)."""
        return TransposedTransport(self)

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
        images = self.forward(planar, range(self.channels))
        shape = (len(images), *self.camera_shape, self.channels)
        return np.moveaxis(images, 1, -1).reshape(shape)

    def correspondence(self) -> Correspondence:
        """Return which place of the projector lights each camera pixel directly.

        Places to a fraction of a pixel, their confidence and a mask; InputError for a projector of
        several views. See `rfpipe.transport.correspondence`.
        """
        from rfpipe.transport.correspondence import correspondence_of

        return correspondence_of(self)

    def relight_environment(
        self, environment: NDArray[Any], lights: NDArray[Any], turned: float = 0.0
    ) -> Float:
        """Relight with a panorama of the light around; the projector's rays are single lights.

        Parameters are those of `rfpipe.environment.environment_weights`; `lights` has a direction
        for each ray. Returns the image (*camera_shape, channels), in colour if either is.

        Raises InputError as there, or if there are more or fewer directions than lights.
        """
        from rfpipe.environment import environment_weights

        weights = environment_weights(environment, lights, turned)
        if len(weights) != self.shape[2]:
            raise InputError(f"{len(weights)} directions of lights for {self.shape[2]} lights")
        planes = weights.T.reshape(-1, *self.projector_shape)
        if self.channels == 1 or len(planes) == 1:
            return np.concatenate([self.relight(plane) for plane in planes], axis=-1)
        return self.relight(np.moveaxis(planes, 0, -1))

    def pattern_for(self, picture: NDArray[Any]) -> Compensation:
        """Return the pattern, of weights between 0 and 1, that makes the scene look like a picture.

        See `rfpipe.transport.compensation.compensation_for`.
        """
        from rfpipe.transport.compensation import compensation_for

        return compensation_for(self, picture)

    def between_some(self, seen: NDArray[np.bool_], lit: NDArray[np.bool_]) -> Light:  # noqa: ARG002
        """Return a transport that is the same between camera rays `seen` and projector rays `lit`.

        Light between other rays may be missing. Both are bool (rays,).
        """
        return self

    def channel(self, index: int) -> LinearOperator:
        """Return one channel's matrix, rows x columns, as a scipy ``LinearOperator``."""
        from scipy.sparse.linalg import LinearOperator

        if not 0 <= index < self.channels:
            raise InputError(f"channel {index} of a transport with channels 0..{self.channels - 1}")

        def applied(apply: Any) -> Any:
            def of(x: NDArray[Any]) -> Float:
                """Apply to a vector or to the columns of a matrix; scipy restores x's shape."""
                columns = as_weights(x, "the vector").reshape(len(x), -1)
                planar = np.ascontiguousarray(columns.T[:, None], np.float32)
                image: Float = apply(planar, [index])[:, 0].T
                return image

            return of

        forward, adjoint = applied(self.forward), applied(self.adjoint)
        return LinearOperator(
            shape=self.shape[1:],
            matvec=forward,
            rmatvec=adjoint,
            matmat=forward,
            rmatmat=adjoint,
            dtype=np.dtype(np.float32),
        )

    def to_xarray(self, rows: Rays = None, columns: Rays = None) -> DataArray:
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
        try:
            from xarray import DataArray
        except ImportError as error:
            raise InputError(f"to_xarray needs xarray; {installing('xarray')}") from error
        rays = {
            "camera": chosen_rays(rows, self.camera_shape, "rows"),
            "projector": chosen_rays(columns, self.projector_shape, "columns"),
        }
        about = {"camera_shape": self.camera_shape, "projector_shape": self.projector_shape}
        matrix = self.toarray(*rays.values())
        return DataArray(matrix, rays, ("channel", *rays), "radiance per weight", about)

    def save(
        self, path: str | Path, *, rows: Rays = None, columns: Rays = None, limit_bytes: int = LIMIT
    ) -> None:
        """Write the matrix into a file, part by part, complete or not at all.

        Parameters
        ----------
        path : path
            Ends in ``.npz``, ``.h5``, ``.hdf5`` or ``.mat`` (v7.3), see docs/export.md. What stands
            there is replaced.
        rows, columns
            As in `toarray`.
        limit_bytes : int
            That the matrix may take before compression.

        Raises
        ------
        InputError
            If the name ends otherwise, there is no such ray, or the matrix is larger.
        StoreError
            If the file can't be written, or the package that writes it isn't installed.
        """
        from rfpipe.transport.matrix_out import write_matrix

        write_matrix(self, Path(path), rows, columns, limit_bytes)


class Transport(Light):
    """Light transport ``T``, one matrix a colour channel: rows camera rays, columns projector rays.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        The ray domains, see `rfpipe.blocks.RayDomain`.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    held
        Its arrays, or objects that hold them, in memory or read when used.
    nbytes : int, optional
        Bytes on disk; by default those of the arrays in memory.
    """

    kind: ClassVar[str]
    """The name of the class in stores."""

    stored_names: ClassVar[tuple[str, ...]] = ("camera_shape", "projector_shape")
    """Attributes that a store keeps and the constructor takes, beside channels and levels."""

    def __init__(
        self,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        held: Any,
        nbytes: int | None = None,
    ) -> None:
        self.camera_shape = tuple(camera_shape)
        self.projector_shape = tuple(projector_shape)
        self.channels = channels
        self.level_rows = level_rows
        self._held = held
        self._nbytes = nbytes

    def __repr__(self) -> str:
        channels = f"{self.channels} channel{'s' if self.channels > 1 else ''}"
        count = sum(int(row.get("patterns", 0)) for row in self.level_rows)
        patterns = f"{count:,} patterns, " if count else ""
        return (
            f"{type(self).__name__}(camera {self.camera_shape}, projector {self.projector_shape}, "
            f"{channels}, {patterns}{self.nbytes / 1e6:.3g} MB)"
        )

    def holding(self, level_rows: list[dict[str, Any]], held: Any) -> Self:
        """Return a transport between the same rays that is made of something else."""
        stored: dict[str, Any] = {name: getattr(self, name) for name in self.stored_names}
        return type(self)(channels=self.channels, level_rows=level_rows, held=held, **stored)

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the named arrays and the attributes that a store keeps."""
        return self._packed(number_format), {
            "kind": self.kind,
            "number_format": number_format,
            **{name: getattr(self, name) for name in self.stored_names},
            "channels": self.channels,
            "levels": self.level_rows,
        }

    @classmethod
    def unpack(cls, bundle: ArrayBundle, memory_budget: int) -> Self:
        """Build a transport from a store; what fits into `memory_budget` bytes stays in memory."""
        about = bundle.attributes
        if "shape" in about:  # of both sides, in stores of older versions
            about = {**about, "camera_shape": about["shape"], "projector_shape": about["shape"]}
        return cls(
            channels=about["channels"],
            level_rows=about["levels"],
            held=cls._opened(bundle, bundle.nbytes <= memory_budget),
            nbytes=bundle.nbytes_stored,
            **{name: about[name] for name in cls.stored_names if name in about},
        )

    def _packed(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        """Return what is held as named arrays, for `pack`."""
        raise NotImplementedError

    @classmethod
    def _opened(cls, bundle: ArrayBundle, keep: bool) -> Any:
        """Return what a store holds, read when used, to be kept in memory or not, for `unpack`."""
        raise NotImplementedError

    @abstractmethod
    def _bytes_in_memory(self) -> int:
        """Return the bytes of the arrays."""

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Return the light between few patterns, ``R^T T S`` of one channel, float32 (Q, P).

        R (camera rays, Q) is how the light that arrives is weighed, S (projector rays, P) patterns.
        """
        matrix = np.empty((received.shape[1], sent.shape[1]), np.float32)
        for first in range(0, sent.shape[1], _BATCH):
            patterns = np.ascontiguousarray(sent[:, first : first + _BATCH].toarray().T)
            images = self.forward(patterns[:, None], [channel])[:, 0]
            matrix[:, first : first + _BATCH] = received.T @ images.T
        return matrix

    def truncate(self, level: int) -> Transport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7).

        Raises
        ------
        InputError
            If `level` is none of `known_levels`.
        """
        levels = self.known_levels
        if level not in levels:
            when = f"{levels[0]} to {levels[-1]}"
            if len(levels) == 1:
                when = (
                    f"{levels[0]} alone, since all its pictures are fitted together. To see what "
                    "fewer make of it, acquire it again with a limit of patterns"
                )
            raise InputError(f"level {level} of a {type(self).__name__}, known after level {when}")
        return self

    @property
    def known_levels(self) -> range:
        """Levels after which the transport is known: the last, where it is fitted as a whole."""
        return range(self.last_level, self.last_level + 1)

    @property
    def last_level(self) -> int:
        """The last of `known_levels`."""
        return max((int(row["level"]) for row in self.level_rows), default=0)

    @property
    def levels(self) -> pd.DataFrame:
        """Per level: patterns, nodes, empty, rank-1, scalar and subdivided ones (Fig. 5.10)."""
        import pandas as pd

        return pd.DataFrame(self.level_rows)

    @property
    def history(self) -> pd.DataFrame:
        """The method's estimates of its error: `HISTORY_COLUMNS`, a row for each level with one."""
        import pandas as pd

        table = pd.DataFrame(estimates(self.level_rows), columns=list(HISTORY_COLUMNS))
        kinds = dict.fromkeys(HISTORY_COLUMNS[:2], "int64")
        return table.astype(kinds | dict.fromkeys(HISTORY_COLUMNS[2:], "float64"))

    @property
    def nbytes(self) -> int:
        """Bytes stored: on disk if opened from a store, of the arrays if in memory."""
        return self._bytes_in_memory() if self._nbytes is None else self._nbytes

    def save(
        self,
        path: str | Path,
        *,
        rows: Rays = None,
        columns: Rays = None,
        limit_bytes: int = LIMIT,
        number_format: NumberFormat | None = None,
    ) -> None:
        """Write the transport into a store, ``.zarr``, or its matrix into a file.

        A matrix takes `rows`, `columns` and `limit_bytes` as `Light.save`, a store `number_format`
        as `save_transport`. Errors as there; InputError where an option isn't for such a file.
        """
        if Path(path).suffix.lower() != ".zarr":
            if number_format is not None:
                raise InputError(f"{path}: a matrix is kept as float32; number_format is of .zarr")
            super().save(path, rows=rows, columns=columns, limit_bytes=limit_bytes)
        elif rows is not None or columns is not None:
            raise InputError(f"{path}: a store holds the whole transport; rows and columns don't")
        else:
            save_transport(self, path, number_format or "float32")


def save_transport(
    transport: Transport,
    path: str | Path,
    number_format: NumberFormat = "float32",
    **attributes: Any,
) -> str:
    """Write a transport into a chunked, compressed store, complete or not at all.

    Parameters
    ----------
    transport : Transport
    path : path
        The store's folder; an older store there is replaced.
    number_format : {"float32", "uint16", "uint8"}
        "float32" keeps every bit. The others round, factors of leaves by about 1e-5 and 3e-3 of
        their values; "uint8" is the default of runs (``storage.number_format``).
    **attributes
        Plain data to keep beside the transport's own (scene, method, fingerprints).

    Returns
    -------
    str
        Digest of the contents.

    Raises
    ------
    InputError
        If the number format is none of the three.
    """
    if number_format not in get_args(NumberFormat):
        expected = ", ".join(get_args(NumberFormat))
        raise InputError(f"number format {number_format!r}; expected one of {expected}")
    arrays, packed = transport.pack(number_format)
    by_parts = len(transport.camera_shape) > 2
    return write_arrays(Path(path), arrays, {**attributes, **packed}, small=True, by_parts=by_parts)


class TransposedTransport(Light):
    """The dual of a transport: light from the camera's rays, seen by the projector."""

    def __init__(self, primal: Light) -> None:
        self._primal = primal
        self.camera_shape = primal.projector_shape
        self.projector_shape = primal.camera_shape
        self.channels = primal.channels

    def __repr__(self) -> str:
        return f"{self._primal!r}.T"

    @property
    def T(self) -> Light:  # noqa: N802
        """The transport that this is the dual of."""
        return self._primal

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar patterns ``(P, K, camera rays)``."""
        return self._primal.adjoint(patterns, channels)

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar images ``(P, K, projector rays)``."""
        return self._primal.forward(images, channels)

    def between_some(self, seen: NDArray[np.bool_], lit: NDArray[np.bool_]) -> Light:
        """Return a dual that is the same between some rays, see `Light.between_some`."""
        return self._primal.between_some(lit, seen).T


def planar_patterns(patterns: NDArray[Any], shape: tuple[int, ...], channels: int) -> Float:
    """Bring patterns ``(P, *shape[, channels])`` into planar form ``(P, channels, rays)``.

    White light is the same memory for all channels.
    """
    patterns = as_weights(patterns)
    count = patterns.shape[0]
    if patterns.shape == (count, *shape):
        rays = np.ascontiguousarray(patterns, np.float32).reshape(count, 1, -1)
        planar = np.broadcast_to(rays, (count, channels, rays.shape[-1]))
    elif patterns.shape == (count, *shape, channels):
        planes = np.moveaxis(patterns.reshape(count, -1, channels), -1, 1)
        planar = np.ascontiguousarray(planes, np.float32)
    else:
        raise InputError(
            f"a pattern has the shape {shape} or {(*shape, channels)}, got {patterns.shape[1:]}"
        )
    if not np.isfinite(patterns).all():
        raise InputError("a pattern holds NaN or infinite weights; all weights must be finite")
    return planar


def estimates(level_rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return `HISTORY_COLUMNS` of the rows of levels that have an ``estimated_error``."""
    errors, count = [], 0
    for row in level_rows:
        count += int(row["patterns"])
        if "estimated_error" in row:
            known = {name: float(row.get(name, np.nan)) for name in HISTORY_COLUMNS[2:]}
            errors.append({"level": int(row["level"]), "patterns": count, **known})
    return errors
