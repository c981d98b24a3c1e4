"""A transport as a program: a few kinds of linear operations between vectors.

A browser knows nothing of hierarchical tensors or B-splines. What it runs is a list of operations,
each of which adds a matrix times one buffer to another buffer. Backwards, each transposed, the same
list is the dual. Buffers are planar, one plane a channel; all begin as zeros but the one that holds
the light.
"""

from __future__ import annotations

import gzip
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.files import digest_of

Kind = Literal["gather", "scale", "csr", "dense", "pairs", "leaves"]

PROJECTOR, CAMERA = 0, 1
"""The buffers of the two sides' rays."""

SHORT = 12
"""A leaf over so many pairs of rays or fewer is worked off pair by pair: to set out on it takes
longer."""

# What a leaf, and an entry that is looked up, take beside a product in a long run of numbers.
_A_LEAF, _AN_ENTRY = 100, 5

_TYPES = {"int32": "i4", "float32": "f4", "uint8": "u1", "uint16": "u2"}
_PLAIN = (
    "kind", "source", "target", "source_at", "target_at", "transposed", "shared", "chain", "levels",
)  # fmt: skip
_GZIP_LEVEL = 6  # 9 takes four times as long for one per cent less


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
          (n,) and ``values`` float32 (C, n). Never transposed; what comes twice adds up.
        - ``leaves``: symmetric; each of ``block_a``, ``block_b`` int32 (n,) are two runs of a
          buffer, block ``b`` of ``sizes`` int32 (blocks,) positions, and A has the product of two
          factors there, and its transpose. The factors stand one leaf after the other, that over
          a, then that over b unless it is the same: ``values`` float32 (C, m); or ``codes`` uint8
          or uint16 (C, m), all channels but the first folded differences to it, and ``scales``
          float32 (C, n): a factor is its code squared times its leaf's scale.
    source, target : int
        Buffers.
    arrays : dict of str to ndarray
    digests : dict of str to str
        Of the arrays' types, shapes and contents.
    levels : list of int
        At which it runs.
    source_at, target_at : int
        Where in its buffer the operation begins.
    transposed : bool
    shared : bool
        Whether the operations of a chain that are shared may be run by different workers; each
        then runs those of the chain that are not, and the results are added.
    chain, step : int
        Operations of one chain feed each other, step by step.
    part : str
        The part of the transport that it belongs to; none if to several.
    """

    kind: Kind
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

    def plain(self, parts: Sequence[str], number: Mapping[str, int]) -> dict[str, Any]:
        """Return it as plain data: its part by number, and its arrays by those of their digests."""
        about = {name: getattr(self, name) for name in _PLAIN}
        entries, work = self._effort()
        arrays = {name: number[digest] for name, digest in self.digests.items()}
        part = parts.index(self.part) if self.part else -1
        return {**about, "part": part, "work": work, "entries": entries, "arrays": arrays}

    def _effort(self) -> tuple[int, int]:
        """Return the pairs of rays of short leaves, and about how long it takes.

        The latter in units of a product in a long run of numbers.
        """
        size = max(array.size for array in self.arrays.values())
        if self.kind != "leaves":
            return 0, size * (1 if self.kind == "dense" else _AN_ENTRY)
        sizes = self.arrays["sizes"].astype(np.int64)
        a, b = self.arrays["block_a"], self.arrays["block_b"]
        products = np.where(a == b, sizes[a] * (sizes[a] + 1) // 2, sizes[a] * sizes[b])
        is_short = products <= SHORT
        entries = int(products[is_short].sum())
        channels = max(len(array) for array in self.arrays.values() if array.ndim == 2)
        long = int(np.count_nonzero(~is_short))
        return entries, size + channels * (_A_LEAF * long + _AN_ENTRY * entries)


@dataclass
class Program:
    """Operations in the order in which they run, and the sizes of their buffers.

    Attributes
    ----------
    camera_shape, projector_shape : tuple of int
    channels : int
    levels : list of int
        The levels at which the transport can be seen, of its `Transport.known_levels`.
    buffers : list of int
        Positions of each buffer; the first two are `PROJECTOR` and `CAMERA`.
    operations : list of Operation
    blobs : dict of str to bytes
        Arrays that were packed, by their digests.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int
    levels: list[int] = field(default_factory=list)
    buffers: list[int] = field(default_factory=list)
    operations: list[Operation] = field(default_factory=list)
    blobs: dict[str, bytes] = field(default_factory=dict)

    def seen_at(self, levels: Sequence[int]) -> Program:
        """Return the program of some levels only."""
        visible = (
            replace(each, levels=sorted({*each.levels} & {*levels})) for each in self.operations
        )
        operations = [each for each in visible if each.levels]
        return replace(self, levels=sorted(levels), operations=operations)


@dataclass(frozen=True)
class Packed:
    """A program as data for a page.

    Attributes
    ----------
    manifest : dict
        Plain data: shapes, channels, levels, parts, ``buffers``; ``arrays``, each with its
        ``type``, ``shape``, the ``bytes`` of its blob and the first ``level`` that needs it; and
        ``operations``, whose arrays are numbers of those.
    blobs : list of bytes
        One for each array.
    """

    manifest: dict[str, Any]
    blobs: list[bytes]

    @property
    def nbytes(self) -> int:
        """Bytes of all blobs."""
        return sum(map(len, self.blobs))


def pack_array(array: NDArray[Any]) -> bytes:
    """Return an array as a blob.

    Integers of 32 bits as differences, each to the one before; all first bytes of the numbers, then
    all second ones, and on, little-endian, so that alike stands by alike; and gzip.
    """
    flat = np.ascontiguousarray(array).ravel()
    if flat.dtype == np.int32:
        flat = np.diff(flat, prepend=np.int32(0))
    little = flat.astype(flat.dtype.newbyteorder("<"), copy=False)
    planes = little.view(np.uint8).reshape(-1, flat.itemsize).T
    return gzip.compress(planes.tobytes(), _GZIP_LEVEL, mtime=0)


def digest_of_array(array: NDArray[Any]) -> str:
    """Return a digest of an array's type, shape and content."""
    return digest_of(repr((array.dtype.name, array.shape)).encode(), array)


def pack_program(program: Program) -> Packed:
    """Return a program's arrays as blobs, each once, those that coarse levels need first."""
    first: dict[str, int] = {}
    arrays: dict[str, NDArray[Any]] = {}
    for operation in program.operations:
        for name, digest in operation.digests.items():
            arrays.setdefault(digest, operation.arrays[name])
            first[digest] = min(first.get(digest, operation.levels[0]), operation.levels[0])
    order = sorted(arrays, key=lambda digest: first[digest])
    number = {digest: index for index, digest in enumerate(order)}
    for digest in order:
        if digest not in program.blobs:
            program.blobs[digest] = pack_array(arrays[digest])
    named = (operation.part for operation in program.operations)
    parts = list(dict.fromkeys(name for name in named if name))
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
                "bytes": len(program.blobs[digest]),
                "level": first[digest],
            }
            for digest in order
        ],
        "operations": [each.plain(parts, number) for each in program.operations],
    }
    return Packed(manifest, [program.blobs[digest] for digest in order])
