"""A transport as a program: a few kinds of linear operations between vectors.

A browser knows nothing of hierarchical tensors or B-splines. What it runs is a list of operations,
each of which adds a matrix times one buffer to another buffer. Backwards, each transposed, the same
list is the dual. Buffers are planar, one plane a channel; all begin as zeros but the one that holds
the light.
"""

from __future__ import annotations

import gzip
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
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
          float32 (C, n): a factor is its code squared times its leaf's scale. ``signs`` int8
          (C, n) of the products, if any is -1.
    source, target : int
        Buffers.
    arrays : dict of str to ndarray
    source_at, target_at : int
        Where in its buffer the operation begins.
    transposed : bool
    shared : bool
        Whether the operations of a chain that are shared may be run by different workers; each
        then runs those of the chain that are not, and the results are added.
    chain : int
        Operations of one chain feed each other.
    part : str
        The part of the transport that it belongs to; none if to several.
    """

    kind: Kind
    source: int
    target: int
    arrays: Mapping[str, NDArray[Any]]
    source_at: int = 0
    target_at: int = 0
    transposed: bool = False
    shared: bool = False
    chain: int = 0
    step: int = 0
    part: str = ""

    @property
    def work(self) -> int:
        """How long it takes, about, in units of a product in a long run of numbers."""
        size = max(array.size for array in self.arrays.values())
        if self.kind == "leaves":
            entries = self.entries
            few = int(np.count_nonzero(self._products <= SHORT))
            channels = max(len(array) for array in self.arrays.values() if array.ndim == 2)
            long = len(self.arrays["block_a"]) - few
            return size + channels * (_A_LEAF * long + _AN_ENTRY * entries)
        return size * (1 if self.kind == "dense" else _AN_ENTRY)

    @property
    def entries(self) -> int:
        """Pairs of rays of the leaves over at most `SHORT` of them; 0 of other operations."""
        if self.kind != "leaves":
            return 0
        products = self._products
        return int(products[products <= SHORT].sum())

    @property
    def _products(self) -> NDArray[np.int64]:
        sizes = self.arrays["sizes"].astype(np.int64)
        a, b = self.arrays["block_a"], self.arrays["block_b"]
        own = sizes[a] * (sizes[a] + 1) // 2
        products: NDArray[np.int64] = np.where(a == b, own, sizes[a] * sizes[b])
        return products

    @property
    def identity(self) -> str:
        """By which two operations are the same."""
        about = [
            getattr(self, each.name) for each in fields(self) if each.name not in ("arrays", "step")
        ]
        shapes = [(name, array.shape) for name, array in self.arrays.items()]
        return digest_of(repr((about, shapes)).encode(), *self.arrays.values())


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
    levels_of : list of list of int
        The levels at which each operation runs.
    """

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int
    levels: list[int] = field(default_factory=list)
    buffers: list[int] = field(default_factory=list)
    operations: list[Operation] = field(default_factory=list)
    levels_of: list[list[int]] = field(default_factory=list)

    @property
    def parts(self) -> list[str]:
        """The parts' names, in order."""
        named = (operation.part for operation in self.operations)
        return list(dict.fromkeys(name for name in named if name))

    def at_level(self, level: int) -> Iterator[Operation]:
        """Yield the operations that run at a level."""
        for operation, levels in zip(self.operations, self.levels_of, strict=True):
            if level in levels:
                yield operation

    def seen_at(self, levels: Sequence[int]) -> Program:
        """Return the program of some levels only."""
        kept = [sorted(set(found) & set(levels)) for found in self.levels_of]
        return replace(
            self,
            levels=sorted(levels),
            operations=[one for one, found in zip(self.operations, kept, strict=True) if found],
            levels_of=[found for found in kept if found],
        )


_TYPES = {"int32": "i4", "float32": "f4", "uint8": "u1", "uint16": "u2", "int8": "i1"}
_GZIP_LEVEL = 6  # 9 takes four times as long for one per cent less


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

    def seen_at(self, levels: Sequence[int]) -> Packed:
        """Return what some of the levels need."""
        operations = [
            {**operation, "levels": sorted(set(operation["levels"]) & set(levels))}
            for operation in self.manifest["operations"]
        ]
        operations = [operation for operation in operations if operation["levels"]]
        first: dict[int, int] = {}
        for operation in operations:
            for index in operation["arrays"].values():
                first[index] = min(first.get(index, operation["levels"][0]), operation["levels"][0])
        kept = sorted(first, key=lambda index: (first[index], index))
        number = {index: place for place, index in enumerate(kept)}
        for operation in operations:
            operation["arrays"] = {
                name: number[index] for name, index in operation["arrays"].items()
            }
        arrays = [{**self.manifest["arrays"][n], "level": first[n]} for n in kept]
        manifest = {
            **self.manifest,
            "levels": sorted(levels),
            "arrays": arrays,
            "operations": operations,
        }
        return Packed(manifest, [self.blobs[n] for n in kept])


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


def pack_program(program: Program) -> Packed:
    """Return a program's arrays as blobs, each once, those that coarse levels need first."""
    first: dict[str, int] = {}
    arrays: dict[str, NDArray[Any]] = {}
    used: list[dict[str, str]] = []
    for operation, levels in zip(program.operations, program.levels_of, strict=True):
        names = {}
        for name, array in operation.arrays.items():
            names[name] = digest_of(repr((array.dtype.name, array.shape)).encode(), array)
            arrays.setdefault(names[name], array)
            first[names[name]] = min(first.get(names[name], levels[0]), levels[0])
        used.append(names)
    order = sorted(arrays, key=lambda digest: first[digest])
    blobs = [pack_array(arrays[digest]) for digest in order]
    number = {digest: index for index, digest in enumerate(order)}
    manifest = {
        "camera": list(program.camera_shape),
        "projector": list(program.projector_shape),
        "channels": program.channels,
        "levels": program.levels,
        "parts": program.parts,
        "buffers": program.buffers,
        "short": SHORT,
        "arrays": [
            {
                "type": _TYPES[arrays[digest].dtype.name],
                "shape": list(arrays[digest].shape),
                "bytes": len(blobs[number[digest]]),
                "level": first[digest],
            }
            for digest in order
        ],
        "operations": [
            {
                "kind": operation.kind,
                "from": operation.source,
                "to": operation.target,
                "fromAt": operation.source_at,
                "toAt": operation.target_at,
                "transposed": operation.transposed,
                "shared": operation.shared,
                "chain": operation.chain,
                "part": program.parts.index(operation.part) if operation.part else -1,
                "levels": levels,
                "work": operation.work,
                "entries": operation.entries,
                "arrays": {name: number[digest] for name, digest in names.items()},
            }
            for operation, levels, names in zip(
                program.operations, program.levels_of, used, strict=True
            )
        ],
    }
    return Packed(manifest, blobs)
