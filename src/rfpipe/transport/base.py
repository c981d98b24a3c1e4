"""Base class of all transports, and their storage."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.output import suffix_of
from rfpipe.store.arrays import ArrayBundle, write_arrays
from rfpipe.transport.algebra import RaySelection
from rfpipe.transport.relightable import LIMIT, Relightable
from rfpipe.units import NumberFormat

if TYPE_CHECKING:
    import pandas as pd
    from scipy.sparse import csr_array

HISTORY_COLUMNS = ("level", "patterns", "estimated_error", "estimated_indirect")
"""Columns of `Transport.history`: level; number of patterns up to this level, the floodlit pattern
included; estimated error of relit pictures, and of their indirect light, relative to their norm."""

NOISE = "noise"
"""Name of the array of a store with `Relightable.noise`."""

_PATTERNS_PER_BATCH = 64


class Transport(Relightable):
    """Light transport ``T``: one matrix per colour channel, (camera rays, projector rays).

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        The ray domains, see `rfpipe.blocks.RayDomain`.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    content
        Arrays, or objects that contain them, in memory or read when used.
    nbytes : int, optional
        Bytes on disk; by default the bytes of the arrays in memory.
    """

    kind: ClassVar[str]
    """Name of the class in stores."""

    stored_names: ClassVar[tuple[str, ...]] = ("camera_shape", "projector_shape")
    """Arguments of the constructor that a store has, besides channels and levels."""

    def __init__(
        self,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        channels: int,
        level_rows: list[dict[str, Any]],
        content: Any,
        nbytes: int | None = None,
    ) -> None:
        self.camera_shape = tuple(camera_shape)
        self.projector_shape = tuple(projector_shape)
        self.channels = channels
        self.level_rows = level_rows
        self._content = content
        self._nbytes = nbytes

    def __repr__(self) -> str:
        channels = f"{self.channels} channel{'s' if self.channels > 1 else ''}"
        count = sum(int(row.get("patterns", 0)) for row in self.level_rows)
        patterns = f"{count:,} patterns, " if count else ""
        return (
            f"{type(self).__name__}(camera {self.camera_shape}, projector {self.projector_shape}, "
            f"{channels}, {patterns}{self.nbytes / 1e6:.3g} MB)"
        )

    def with_content(self, level_rows: list[dict[str, Any]], content: Any) -> Self:
        """Return a transport of this kind between the same rays, with other levels and content."""
        stored: dict[str, Any] = {name: getattr(self, name) for name in self.stored_names}
        transport = type(self)(
            channels=self.channels, level_rows=level_rows, content=content, **stored
        )
        transport.lights = self.lights
        transport.noise = self.noise
        return transport

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the named arrays and the attributes of a store."""
        return self._to_arrays(number_format), {
            "kind": self.kind,
            "number_format": number_format,
            **{name: getattr(self, name) for name in self.stored_names},
            "channels": self.channels,
            "levels": self.level_rows,
        }

    @classmethod
    def unpack(cls, bundle: ArrayBundle, memory_budget: int) -> Self:
        """Build a transport from a store, in memory if it has at most `memory_budget` bytes."""
        attributes = bundle.attributes
        return cls(
            channels=attributes["channels"],
            level_rows=attributes["levels"],
            content=cls._open(bundle, bundle.nbytes <= memory_budget),
            nbytes=bundle.nbytes_stored,
            **{name: attributes[name] for name in cls.stored_names if name in attributes},
        )

    def _to_arrays(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        """Return the content as named arrays, for `pack`."""
        raise NotImplementedError

    @classmethod
    def _open(cls, bundle: ArrayBundle, keep: bool) -> Any:
        """Return the content of a store, read when used; `keep` it in memory or not."""
        raise NotImplementedError

    @abstractmethod
    def _bytes_in_memory(self) -> int:
        """Return the bytes of the arrays."""

    def between(
        self, received: csr_array[np.float32], sent: csr_array[np.float32], channel: int
    ) -> Float:
        """Compute ``received^T T sent`` of one channel, float32 (Q, P).

        Parameters
        ----------
        received : csr_array, shape (camera rays, Q)
            Weights of camera rays, few for each of Q sums.
        sent : csr_array, shape (projector rays, P)
            P patterns that light few rays.
        channel : int
        """
        matrix = np.empty((received.shape[1], sent.shape[1]), np.float32)
        for first in range(0, sent.shape[1], _PATTERNS_PER_BATCH):
            batch = slice(first, first + _PATTERNS_PER_BATCH)
            patterns = np.ascontiguousarray(sent[:, batch].toarray().T)
            images = self.forward(patterns[:, None], [channel])[:, 0]
            matrix[:, batch] = received.T @ images.T
        return matrix

    def truncate(self, level: int) -> Transport:
        """Return the transport as if the acquisition had stopped after `level` (Fig. 5.7).

        Raises
        ------
        InputError
            If `level` is not in `known_levels`.
        """
        levels = self.known_levels
        if level not in levels:
            when = f"{levels[0]} to {levels[-1]}"
            if len(levels) == 1:
                when = (
                    f"{levels[0]} only, since all pictures are fitted together. For fewer "
                    "patterns, acquire it again with a limit of patterns"
                )
            raise InputError(f"level {level} of a {type(self).__name__}, known after level {when}")
        return self

    @property
    def known_levels(self) -> range:
        """Levels after which the transport is known: the last if all levels are fitted together."""
        return range(self.last_level, self.last_level + 1)

    @property
    def last_level(self) -> int:
        """The last of `known_levels`: the last level with patterns."""
        levels = (int(row["level"]) for row in self.level_rows if row.get("patterns"))
        return max(levels, default=0)

    @property
    def levels(self) -> pd.DataFrame:
        """Table of levels: patterns; nodes; empty, rank-1, scalar, subdivided nodes (Fig. 5.10)."""
        import pandas as pd

        return pd.DataFrame(self.level_rows)

    @property
    def history(self) -> pd.DataFrame:
        """Table of error estimates, `HISTORY_COLUMNS`, with a row for each level that has one."""
        import pandas as pd

        table = pd.DataFrame(estimates(self.level_rows), columns=list(HISTORY_COLUMNS))
        kinds = dict.fromkeys(HISTORY_COLUMNS[:2], "int64")
        return table.astype(kinds | dict.fromkeys(HISTORY_COLUMNS[2:], "float64"))

    @property
    def nbytes(self) -> int:
        """Bytes on disk if the transport is from a store, else of its arrays."""
        return self._bytes_in_memory() if self._nbytes is None else self._nbytes

    def save(
        self,
        path: str | Path,
        *,
        rows: RaySelection = None,
        columns: RaySelection = None,
        limit_bytes: int = LIMIT,
        number_format: NumberFormat | None = None,
    ) -> None:
        """Write the transport into a store, ``.zarr``, or its matrix into a file.

        `rows`, `columns` and `limit_bytes` are options of a matrix, see `Relightable.save`;
        `number_format` is one of a store, see `save_transport`. Errors as there; InputError for an
        option that the kind of file doesn't have.
        """
        from rfpipe.transport.matrix_export import MATRIX_FILES

        if suffix_of(Path(path), (*MATRIX_FILES, ".zarr")) != ".zarr":
            if number_format is not None:
                raise InputError(
                    f"{path}: a matrix is stored as float32; number_format is for .zarr"
                )
            super().save(path, rows=rows, columns=columns, limit_bytes=limit_bytes)
        elif rows is not None or columns is not None:
            raise InputError(f"{path}: a store has all rays; rows and columns are for matrices")
        else:
            save_transport(self, path, number_format or "float32")


def save_transport(
    transport: Transport,
    path: str | Path,
    number_format: NumberFormat = "float32",
    *,
    resumes: bool = False,
    **attributes: Any,
) -> str:
    """Write a transport into a chunked, compressed store, completely or not at all.

    Parameters
    ----------
    transport : Transport
    path : path
        The store's folder; an existing store is replaced.
    number_format : {"float32", "uint16", "uint8"}
        "float32" is exact. The others round factors of leaves by about 1e-5 and 3e-3 of their
        values; "uint8" is the default of runs (``storage.number_format``).
    resumes : bool
        Whether a run writes it, which resumes after an error; see `rfpipe.output.storage_errors`.
    **attributes
        Plain data to add to the store's attributes (scene, method, fingerprints).

    Returns
    -------
    str
        Digest of the contents.

    Raises
    ------
    InputError
        If the number format is unknown.
    """
    if number_format not in get_args(NumberFormat):
        expected = ", ".join(get_args(NumberFormat))
        raise InputError(f"number format {number_format!r}; expected one of {expected}")
    arrays, packed = transport.pack(number_format)
    if transport.lights is not None:
        attributes["lights"] = transport.lights.tolist()
    if transport.noise is not None:
        arrays = {**arrays, NOISE: transport.noise}
    has_views = len(transport.camera_shape) > 2
    return write_arrays(
        Path(path),
        arrays,
        {**attributes, **packed},
        small=True,
        by_parts=has_views,
        resumes=resumes,
    )


def estimates(level_rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of `Transport.history`, for levels that have an ``estimated_error``."""
    rows, count = [], 0
    for row in level_rows:
        count += int(row["patterns"])
        if "estimated_error" in row:
            errors = {name: float(row.get(name, np.nan)) for name in HISTORY_COLUMNS[2:]}
            rows.append({"level": int(row["level"]), "patterns": count, **errors})
    return rows


def last_estimate(level_rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the last row of `estimates`; empty if there is none."""
    return next(reversed(estimates(level_rows)), {})
