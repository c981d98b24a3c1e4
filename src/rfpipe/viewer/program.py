"""Programs of linear operations between buffers, which relight a transport in the browser.

A program is a list of operations, each of which adds a matrix times one buffer to another buffer.
The same list in reverse order, with transposed matrices, is the dual. Buffers have one plane per
channel, and start as zeros except the one with the light.
"""

from __future__ import annotations

import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.files import digest_of

OperationKind = Literal["gather", "scale", "csr", "dense", "pairs", "leaves"]

PROJECTOR, CAMERA = 0, 1
"""Numbers of the buffers of the projector's and the camera's rays."""

SHORT = 12
"""Largest number of pairs of rays in a leaf that is evaluated pair by pair, which is faster."""

# Cost of a leaf and of an indexed entry, relative to a multiplication in a dense product.
_LEAF_COST, _ENTRY_COST = 100, 5

_TYPES = {"int32": "i4", "float32": "f4", "uint8": "u1", "uint16": "u2"}
_GZIP_LEVEL = 6  # level 9 takes four times as long and saves 1 %


@dataclass(frozen=True, eq=False)
class Operation:
    """One operation: ``target += A source``, or ``target += A^T source`` if it is transposed.

    Attributes
    ----------
    kind : str
        - ``gather``: ``(A x)[i] = x[index[i]]``; ``index`` int32 (n,).
        - ``scale``: A is diagonal; ``values`` float32 (C or 1, n).
        - ``csr``: row ``i`` of A has ``counts[i]`` entries, one row after the other: ``columns``
          int32 (entries,) and ``values`` float32 (C or 1, entries).
        - ``dense``: ``values`` float32 (C, rows, columns).
        - ``pairs``: symmetric; ``A[a, b] = A[b, a] = v`` for each of ``first``, ``second`` int32
          (n,) and ``values`` float32 (C, n). Never transposed; duplicate pairs add up.
        - ``leaves``: symmetric; leaf i is the outer product of two factors, over the blocks
          ``block_a[i]`` and ``block_b[i]`` int32 (n,), and its transpose. Blocks are contiguous in
          the buffer and have ``sizes`` int32 (blocks,). Factors are stored leaf by leaf, over a
          and, unless a = b, over b: as ``values`` float32 (C, m); or as ``codes`` uint8 or uint16
          (C, m), where channels after the first are folded differences to it, and ``scales``
          float32 (C, n): a factor is its code squared times its leaf's scale.
    source, target : int
        Numbers of buffers.
    arrays : dict of str to ndarray
    digests : dict of str to str
        Digests of the arrays' types, shapes and contents.
    levels : list of int
        Levels at which it runs.
    source_at, target_at : int
        First position in each buffer.
    transposed : bool
    shared : bool
        True if the shared operations of a chain may be distributed among workers. Each worker
        runs all other operations of the chain, and the results are added.
    chain, step : int
        Operations of a chain run step by step, each with results of the previous one.
    part : str
        Part of the transport that it belongs to; empty if it belongs to several.
    """

    kind: OperationKind
    source: int
    target: int
    arrays: Mapping[str, NDArray[Any]]
    digests: Mapping[str, str]
    levels: list[int]
    source_at: int = 0
    target_at: int = 0
    transposed: bool = False
    shared: bool = False
    chain: int = 0
    step: int = 0
    part: str = ""

    @property
    def identity(self) -> tuple[Any, ...]:
        """All properties except levels and step; equal for operations with equal effect."""
        properties = (self.source_at, self.target_at, self.transposed, self.shared)
        ends = (self.kind, self.source, self.target, self.chain, self.part)
        return (*ends, *properties, *self.digests.items())

    def to_json(self, parts: Sequence[str], numbers: Mapping[str, int]) -> dict[str, Any]:
        """Convert to plain data, with numbers of the part and of the arrays (by digest)."""
        entries, work = self._cost()
        return {
            "kind": self.kind,
            "source": self.source,
            "target": self.target,
            "source_at": self.source_at,
            "target_at": self.target_at,
            "transposed": self.transposed,
            "shared": self.shared,
            "chain": self.chain,
            "levels": self.levels,
            "part": parts.index(self.part) if self.part else -1,
            "work": work,
            "entries": entries,
            "arrays": {name: numbers[digest] for name, digest in self.digests.items()},
        }

    def _cost(self) -> tuple[int, int]:
        """Return the number of pairs of rays in short leaves, and the approximate cost.

        The unit of cost is a multiplication in a dense product.
        """
        size = max(array.size for array in self.arrays.values())
        if self.kind != "leaves":
            return 0, size * (1 if self.kind == "dense" else _ENTRY_COST)
        sizes = self.arrays["sizes"].astype(np.int64)
        a, b = self.arrays["block_a"], self.arrays["block_b"]
        products = np.where(a == b, sizes[a] * (sizes[a] + 1) // 2, sizes[a] * sizes[b])
        is_short = products <= SHORT
        entries = int(products[is_short].sum())
        channels = max(len(array) for array in self.arrays.values() if array.ndim == 2)
        n_long = int(np.count_nonzero(~is_short))
        return entries, size + channels * (_LEAF_COST * n_long + _ENTRY_COST * entries)


@dataclass(frozen=True)
class Program:
    """Operations in the order of execution, and the sizes of their buffers.

    Attributes
    ----------
    camera_shape, projector_shape : tuple of int
    channels : int
    levels : list of int
        Levels that can be displayed, a subset of `Transport.known_levels`.
    buffers : list of int
        Size of each buffer; the first two are `PROJECTOR` and `CAMERA`.
    operations : list of Operation
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int
    levels: list[int]
    buffers: list[int]
    operations: list[Operation]

    def restricted_to(self, levels: Sequence[int]) -> Program:
        """Return the program of some of its levels."""
        restricted = (
            replace(operation, levels=sorted({*operation.levels} & {*levels}))
            for operation in self.operations
        )
        operations = [operation for operation in restricted if operation.levels]
        return replace(self, levels=sorted(levels), operations=operations)


@dataclass(frozen=True)
class Packed:
    """A program as data in a page.

    Attributes
    ----------
    manifest : dict
        Plain data: shapes, channels, levels, parts, ``buffers``; ``arrays``, each with its
        ``type``, ``shape``, size of its blob (``bytes``) and the first ``level`` that uses it; and
        ``operations``, with numbers of arrays.
    blobs : list of bytes
        One for each array.
    """

    manifest: dict[str, Any]
    blobs: list[bytes]

    @property
    def nbytes(self) -> int:
        """Total size of the blobs in bytes."""
        return sum(map(len, self.blobs))


def pack_array(array: NDArray[Any]) -> bytes:
    """Compress an array.

    32-bit integers are replaced by differences to the previous one. Then bytes are shuffled (all
    first bytes of the little-endian numbers, then all second bytes, ...) and compressed by gzip.
    """
    flat = np.ascontiguousarray(array).ravel()
    if flat.dtype == np.int32:
        flat = np.diff(flat, prepend=np.int32(0))
    little = flat.astype(flat.dtype.newbyteorder("<"), copy=False)
    planes = little.view(np.uint8).reshape(-1, flat.itemsize).T
    return gzip.compress(planes.tobytes(), _GZIP_LEVEL, mtime=0)


def digest_of_array(array: NDArray[Any]) -> str:
    """Compute a digest of an array's type, shape and content."""
    return digest_of(repr((array.dtype.name, array.shape)).encode(), array)


def pack_program(program: Program, blobs: dict[str, bytes] | None = None) -> Packed:
    """Compress a program's arrays, each once, in the order of the levels that need them.

    `blobs`, by digests, caches compressed arrays for several calls; new ones are added.
    """
    blobs = {} if blobs is None else blobs
    first: dict[str, int] = {}
    arrays: dict[str, NDArray[Any]] = {}
    for operation in program.operations:
        for name, digest in operation.digests.items():
            arrays.setdefault(digest, operation.arrays[name])
            first[digest] = min(first.get(digest, operation.levels[0]), operation.levels[0])
    order = sorted(arrays, key=lambda digest: first[digest])
    numbers = {digest: index for index, digest in enumerate(order)}
    for digest in order:
        if digest not in blobs:
            blobs[digest] = pack_array(arrays[digest])
    names = (operation.part for operation in program.operations)
    parts = list(dict.fromkeys(name for name in names if name))
    manifest = {
        "camera": list(program.camera_shape),
        "projector": list(program.projector_shape),
        "channels": program.channels,
        "levels": program.levels,
        "parts": parts,
        "buffers": program.buffers,
        "short": SHORT,
        "arrays": [
            {
                "type": _TYPES[arrays[digest].dtype.name],
                "shape": list(arrays[digest].shape),
                "bytes": len(blobs[digest]),
                "level": first[digest],
            }
            for digest in order
        ],
        "operations": [operation.to_json(parts, numbers) for operation in program.operations],
    }
    return Packed(manifest, [blobs[digest] for digest in order])
