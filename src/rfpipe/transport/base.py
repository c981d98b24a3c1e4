"""What every transport is: light between rays, with its levels, that a store keeps."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, get_args

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.output import suffix_of
from rfpipe.store.arrays import ArrayBundle, write_arrays
from rfpipe.transport.algebra import RaySelection
from rfpipe.transport.relightable import LIMIT, Relightable
from rfpipe.units import NumberFormat

if TYPE_CHECKING:
    import pandas as pd
    from scipy.sparse import csr_array

Float = NDArray[np.float32]

HISTORY_COLUMNS = ("level", "patterns", "estimated_error", "estimated_indirect")
"""Level; patterns shown up to there, the floodlit one included; the error that the method then
estimated, relative to the norm of a relit image."""

NOISE = "noise"
"""Array of a store that holds `Relightable.noise`, beside those of the transport itself."""

_BATCH = 64


class Transport(Relightable):
    """Light transport ``T``, one matrix a colour channel: rows camera rays, columns projector rays.

    Parameters
    ----------
    camera_shape, projector_shape : tuple of int
        The ray domains, see `rfpipe.blocks.RayDomain`.
    channels : int
    level_rows : list of dict
        The rows of `levels`.
    content
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
        """Return a transport between the same rays that is made of something else."""
        stored: dict[str, Any] = {name: getattr(self, name) for name in self.stored_names}
        made = type(self)(channels=self.channels, level_rows=level_rows, content=content, **stored)
        made.lights = self.lights
        made.noise = self.noise
        return made

    def pack(
        self, number_format: NumberFormat = "float32"
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Return the named arrays and the attributes that a store keeps."""
        return self._to_arrays(number_format), {
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
        return cls(
            channels=about["channels"],
            level_rows=about["levels"],
            content=cls._open(bundle, bundle.nbytes <= memory_budget),
            nbytes=bundle.nbytes_stored,
            **{name: about[name] for name in cls.stored_names if name in about},
        )

    def _to_arrays(self, number_format: NumberFormat) -> dict[str, NDArray[Any]]:
        """Return what is held as named arrays, for `pack`."""
        raise NotImplementedError

    @classmethod
    def _open(cls, bundle: ArrayBundle, keep: bool) -> Any:
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
        """The last of `known_levels`: the last level that showed patterns."""
        shown = (int(row["level"]) for row in self.level_rows if row.get("patterns"))
        return max(shown, default=0)

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
    *,
    resumes: bool = False,
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
    resumes : bool
        Whether a run writes it, which goes on after an error; see `rfpipe.output.storage_errors`.
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
    if transport.lights is not None:
        attributes["lights"] = transport.lights.tolist()
    if transport.noise is not None:
        arrays = {**arrays, NOISE: transport.noise}
    by_parts = len(transport.camera_shape) > 2
    return write_arrays(
        Path(path), arrays, {**attributes, **packed}, small=True, by_parts=by_parts, resumes=resumes
    )


def estimates(level_rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return `HISTORY_COLUMNS` of the rows of levels that have an ``estimated_error``."""
    errors, count = [], 0
    for row in level_rows:
        count += int(row["patterns"])
        if "estimated_error" in row:
            known = {name: float(row.get(name, np.nan)) for name in HISTORY_COLUMNS[2:]}
            errors.append({"level": int(row["level"]), "patterns": count, **known})
    return errors


def last_estimate(level_rows: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the last of `estimates`; empty where there is none."""
    return next(reversed(estimates(level_rows)), {})
