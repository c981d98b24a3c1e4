"""Arrays as the bytes that a page carries: few of them, and quickly undone by a browser."""

from __future__ import annotations

import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.store.files import digest_of
from rfpipe.viewer.program import SHORT, Program

__all__ = ["Packed", "pack_array", "pack_program"]

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
