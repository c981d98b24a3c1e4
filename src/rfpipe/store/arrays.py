"""Bundles of named arrays, such as a transport: written together, read one by one."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator, Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.ranges import ranges
from rfpipe.store.chunks import (
    DAMAGE,
    ChunkedArray,
    layout,
    read_attributes,
    small_layout,
)
from rfpipe.store.files import (
    bytes_on_disk,
    canonical_data,
    canonical_json,
    digest_of,
    digest_of_parts,
    hidden_sibling,
    remove_tree,
    storage_errors,
)
from rfpipe.store.lock import StoreLock
from rfpipe.store.places import METADATA, Place

_KIND = "arrays"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
# Larger arrays are cut into chunks, which can be read separately; several chunks share a file, a
# shard, so that there are few files. Sizes are before compression.
_WHOLE_BYTES, _CHUNK_BYTES, _SHARD_BYTES = 2 * 2**20, 2**20, 64 * 2**20
# For arrays that are read in parts: smaller chunks, with files up to 25 % larger.
_FINE_WHOLE_BYTES, _FINE_CHUNK_BYTES = 2**16, 2**15


class ArrayBundle:
    """Named arrays of a folder, or some of them, read on demand; see `open_arrays`.

    Attributes
    ----------
    path : Path or Place
        The folder, a zarr group.
    attributes : dict
        Plain data that the writer stored.
    names : tuple of str
        Names of the arrays, sorted.
    digest : str
        Digest of all arrays and attributes of the folder, as `write_arrays` returned it.
    """

    def __init__(self, path: Path | Place) -> None:
        header = read_attributes(path, _KIND)
        self.path = path
        self._prefix = ""
        try:
            self.attributes: dict[str, Any] = header["attributes"]
            self._entries: dict[str, dict[str, Any]] = header["arrays"]
            self.digest: str = header["digest"]
            is_whole = self.digest == _bundle_digest(self._entries, self.attributes, path)
        except (KeyError, InputError):
            is_whole = False
        if not is_whole:
            raise IntegrityError(
                "attributes don't match their digest", place=path, remedy=_remedy(path)
            )
        self.names: tuple[str, ...] = tuple(sorted(self._entries))

    def part(self, prefix: str, attributes: dict[str, Any]) -> ArrayBundle:
        """Return the arrays whose names begin with `prefix`, by their names without it."""
        part = object.__new__(ArrayBundle)
        part.__dict__ |= self.__dict__
        part.attributes, part._prefix = attributes, self._prefix + prefix
        names = (name.removeprefix(prefix) for name in self.names if name.startswith(prefix))
        part.names = tuple(names)
        return part

    def without(self, name: str) -> ArrayBundle:
        """Return the bundle without the array of this name, if it has one."""
        part = self.part("", self.attributes)
        part.names = tuple(kept_name for kept_name in self.names if kept_name != name)
        return part

    def shape(self, name: str) -> tuple[int, ...]:
        """Return the shape of an array without reading it; InputError for an unknown name."""
        return tuple(self._entry(name)["shape"])

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the dtype of an array; raises as `shape`."""
        dtype: np.dtype[Any] = np.dtype(self._entry(name)["dtype"])
        return dtype

    def read(self, name: str, *, exactly: bool = False) -> NDArray[Any]:
        """Read an array and check it against its digest; see `ChunkedArray` for `exactly`.

        Raises
        ------
        InputError
            When the bundle has no array of this name.
        IntegrityError
            When a chunk is missing, truncated or altered.
        """
        entry = self._entry(name)
        try:
            place = self.path / (self._prefix + name)
            array = ChunkedArray(place, exactly=exactly).read()
            if _array_entry(array) != entry:
                raise ValueError("the digest differs")
        except (IntegrityError, *DAMAGE) as error:
            raise self._damage(name, entry) from error
        return array

    def take(self, name: str, items: NDArray[np.int64]) -> NDArray[Any]:
        """Read items of an array along its last axis, ``(..., items)``, and only their chunks.

        Each of these chunks is checked against its checksum. Raises as `read`.
        """
        entry = self._entry(name)
        try:
            return ChunkedArray(self.path / (self._prefix + name), exactly=True).take(items)
        except (IntegrityError, *DAMAGE) as error:
            raise self._damage(name, entry) from error

    def read_all(self) -> dict[str, NDArray[Any]]:
        """Read all arrays, by name; raises as `read`."""
        return {name: self.read(name) for name in self.names}

    def entry(self) -> dict[str, Any]:
        """Describe the bundle for a manifest: its digest, and dtype and shape of its arrays."""
        keys = ("dtype", "shape")
        arrays = {name: {key: entry[key] for key in keys} for name, entry in self._entries.items()}
        return {"digest": self.digest, "arrays": arrays}

    @property
    def nbytes(self) -> int:
        """Size of the arrays in memory, in bytes."""
        return sum(prod(self.shape(name)) * self.dtype(name).itemsize for name in self.names)

    @property
    def nbytes_stored(self) -> int:
        """Size of the files in bytes; the size in memory if a web server doesn't report it."""
        names = [self._prefix + name for name in self.names] if self._prefix else [""]
        sizes = [
            bytes_on_disk(place) if isinstance(place, Path) else place.nbytes()
            for place in (self.path / name for name in names)
        ]
        return self.nbytes if None in sizes else sum(filter(None, sizes))

    def _entry(self, name: str) -> dict[str, Any]:
        if name not in self.names:
            raise InputError(
                "no array of this name",
                value=name,
                place=self.path,
                remedy=f"expected one of {', '.join(self.names)}",
            )
        return self._entries[self._prefix + name]

    def _damage(self, name: str, entry: dict[str, Any]) -> IntegrityError:
        name = self._prefix + name
        return IntegrityError(
            f"array {name!r} is missing, truncated or altered: its digest isn't {entry['digest']}",
            place=self.path / name,
            remedy=_remedy(self.path),
        )


def write_arrays(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    attributes: dict[str, Any],
    *,
    small: bool = False,
    by_parts: bool = False,
    resumes: bool = True,
) -> str:
    """Write a bundle completely or not at all; it replaces a previous one.

    The bundle is written under a temporary name and renamed, so that an interrupted write leaves
    the previous bundle or nothing. Equal arrays and attributes give identical bytes. The files are
    not synced to the disk, which would take longer than writing them; the digests reveal damage by
    a power failure.

    Parameters
    ----------
    path : Path
        Folder of the bundle.
    arrays : mapping of str to ndarray
        Boolean, integer or float arrays of any shape, including length 0. Each array costs about
        3 ms and two files. A `ScratchArray` is read a part at a time.
    attributes : dict
        Plain data: units, versions, fingerprints.
    small : bool
        Compress more, see `rfpipe.store.chunks.small_layout`.
    by_parts : bool
        Cut arrays into smaller chunks, for reading parts of them by `ArrayBundle.take`.
    resumes : bool
        As in `storage_errors`.

    Returns
    -------
    str
        Digest of all arrays and attributes.

    Raises
    ------
    InputError
        When a name, a dtype or an attribute can't be stored, or `path` exists and isn't a bundle.
    LockedError
        When another process writes the bundle.
    StoreError
        When the disk is full or the folder isn't writable; the previous bundle stays.
    """
    entries: dict[str, dict[str, Any]] = {}
    for name, array in sorted(arrays.items()):
        if not _NAME.fullmatch(name) or name == METADATA or array.dtype.kind not in "buif":
            raise InputError(
                f"array {name!r} of {array.dtype} can't be stored",
                place=path,
                remedy="expected booleans, integers or floats, and a name of letters, digits, '_', "
                "'.' and '-'",
            )
        entries[name] = _array_entry(array)
    digest = _bundle_digest(entries, attributes, path)
    header: dict[str, Any] = {
        "kind": _KIND,
        "digest": digest,
        "arrays": entries,
        "attributes": attributes,
    }
    header = canonical_data(header, f"{path}: attributes")
    needed = sum(
        prod(entry["shape"]) * np.dtype(entry["dtype"]).itemsize for entry in entries.values()
    )
    new = hidden_sibling(path, "new")
    with StoreLock(path), storage_errors(path, "writing arrays", needed, resumes=resumes):
        if path.exists():
            _refuse_foreign(path)
        remove_tree(new)
        try:
            _write_group(new, arrays, header, small, by_parts)
            remove_tree(path)
            new.rename(path)
        except OSError:
            shutil.rmtree(new, ignore_errors=True)  # to free the space; the next write clears up
            raise
    return digest


def open_arrays(path: Path | Place) -> ArrayBundle:
    """Open a bundle; StoreError if it doesn't exist, IntegrityError for damaged metadata."""
    return ArrayBundle(path)


def _remedy(path: Path | Place) -> str:
    if not isinstance(path, Path):
        return f"Fetch {path} again; if it was replaced meanwhile, open it again"
    return f"Remove {path} and its manifest, and run the stage that writes it again"


def _write_group(
    path: Path,
    arrays: Mapping[str, NDArray[Any]],
    header: dict[str, Any],
    small: bool,
    by_parts: bool,
) -> None:
    import zarr
    from zarr.codecs import Crc32cCodec

    group = zarr.create_group(path, attributes=header)
    for name, array in sorted(arrays.items()):
        chunks, shards = _grid(array, by_parts)
        options = small_layout(array.dtype) if small else layout()
        if shards is not None:
            options["compressors"] = [options["compressors"], Crc32cCodec()]
        stored = group.create_array(
            name, shape=array.shape, dtype=array.dtype, chunks=chunks, shards=shards, **options
        )
        # ten shards at a time, as zarr would write them, take 0.7 GiB more and are no faster
        axis = int(np.argmax(stored.shape)) if stored.shape else 0
        for part in _parts(stored.shape, axis, (shards or chunks or (1,))[axis]):
            stored[part] = array[part]


def _grid(array: NDArray[Any], by_parts: bool) -> tuple[tuple[int, ...], tuple[int, ...] | None]:
    """Return the shapes of an array's chunks and of its shards; None without shards."""
    shape = tuple(max(1, length) for length in array.shape)
    small, fine = _WHOLE_BYTES, _CHUNK_BYTES
    if by_parts:
        small, fine = _FINE_WHOLE_BYTES, _FINE_CHUNK_BYTES
    if array.nbytes <= small:
        return shape, None
    axis = int(np.argmax(shape))
    slice_bytes = array.nbytes // shape[axis]
    step = max(1, fine // slice_bytes)
    slices = min(-(-shape[axis] // step), max(1, _SHARD_BYTES // (step * slice_bytes)))
    chunk, shard = ((*shape[:axis], n * step, *shape[axis + 1 :]) for n in (1, slices))
    return chunk, shard if slices > 1 else None


def _refuse_foreign(path: Path) -> None:
    """Raise InputError for a folder that rfpipe didn't write; a damaged bundle may be replaced."""
    try:
        read_attributes(path, _KIND)
    except IntegrityError:
        return
    except StoreError as error:
        raise InputError(
            "a file or folder other than a bundle of arrays exists here",
            place=path,
            remedy="move it away or choose another place",
        ) from error


def _parts(shape: tuple[int, ...], axis: int, longest: int) -> Iterator[tuple[Any, ...]]:
    """Yield indices of the parts of an array, of a largest length along an axis."""
    if not shape:
        yield ()
    elif prod(shape):
        for first, last in ranges(shape[axis], longest):
            yield (*(slice(None),) * axis, slice(first, last))


def _array_entry(array: NDArray[Any]) -> dict[str, Any]:
    """Describe an array, which is read a few rows at a time."""
    longest = max(1, _SHARD_BYTES * len(array) // max(1, array.nbytes)) if array.shape else 1
    parts = (np.ascontiguousarray(array[part]) for part in _parts(array.shape, 0, longest))
    return {
        "digest": digest_of_parts(parts),
        "dtype": array.dtype.str,
        "shape": list(array.shape),
    }


def _bundle_digest(entries: dict[str, Any], attributes: dict[str, Any], path: Path | Place) -> str:
    return digest_of(canonical_json([entries, attributes], f"{path}: attributes"))
