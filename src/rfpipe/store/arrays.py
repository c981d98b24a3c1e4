"""Bundles of named arrays: a transport, a level's nodes, written at once and read lazily."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store.chunks import (
    DAMAGE,
    ChunkedArray,
    layout,
    read_attributes,
    small_layout,
)
from rfpipe.store.files import (
    bytes_on_disk,
    canonical_json,
    digest_of,
    hidden_sibling,
    plain,
    remove_tree,
    storage_errors,
)
from rfpipe.store.lock import StoreLock
from rfpipe.store.places import METADATA, Place

_KIND = "arrays"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
# Arrays of more than this are cut into chunks, several of which share a file, a shard: files are
# few, and a part of a large array is read by itself. Before compression.
_WHOLE_BYTES, _CHUNK_BYTES, _SHARD_BYTES = 2 * 2**20, 2**20, 64 * 2**20
# Of arrays that are read by parts: finer chunks, which pack up to a quarter worse where what is far
# apart is alike.
_FINE_WHOLE_BYTES, _FINE_CHUNK_BYTES = 2**16, 2**15


class ArrayBundle:
    """Named arrays of one folder, or those of a part of it, read on demand; see `open_arrays`.

    Attributes
    ----------
    path : Path or Place
        Its folder, a zarr group; a `Place` is read where it lies.
    attributes : dict
        Plain data that its writer left.
    names : tuple of str
        Of the arrays, sorted.
    digest : str
        Of all arrays and attributes of the folder; what `write_arrays` returned.
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
        """Return the arrays whose names begin with `prefix`, by the rest of their names."""
        part = object.__new__(ArrayBundle)
        part.__dict__ |= self.__dict__
        part.attributes, part._prefix = attributes, self._prefix + prefix
        names = (name.removeprefix(prefix) for name in self.names if name.startswith(prefix))
        part.names = tuple(names)
        return part

    def without(self, name: str) -> ArrayBundle:
        """Return the bundle without the array of a name, if there is one."""
        part = self.part("", self.attributes)
        part.names = tuple(other for other in self.names if other != name)
        return part

    def shape(self, name: str) -> tuple[int, ...]:
        """Shape of an array, without reading it; InputError when there is none of this name."""
        return tuple(self._entry(name)["shape"])

    def dtype(self, name: str) -> np.dtype[Any]:
        """Dtype of an array, as `shape`."""
        dtype: np.dtype[Any] = np.dtype(self._entry(name)["dtype"])
        return dtype

    def read(self, name: str, *, exactly: bool = False) -> NDArray[Any]:
        """Read a whole array and check it against its digest; see `ChunkedArray` for `exactly`.

        Raises
        ------
        InputError
            When there is no array of this name.
        IntegrityError
            When a chunk is missing, truncated or altered.
        """
        entry = self._entry(name)
        try:
            place = self.path / (self._prefix + name)
            array = ChunkedArray(place, exactly=exactly).read()
            if _array_entry(array) != entry:
                raise ValueError("other values")
        except (IntegrityError, *DAMAGE) as error:
            raise self._damage(name, entry) from error
        return array

    def take(self, name: str, items: NDArray[np.int64]) -> NDArray[Any]:
        """Read items of an array along its last axis, ``(..., items)``, and little else of it.

        Each chunk that is read is checked against its checksum. Errors as `read`.
        """
        entry = self._entry(name)
        try:
            return ChunkedArray(self.path / (self._prefix + name), exactly=True).take(items)
        except (IntegrityError, *DAMAGE) as error:
            raise self._damage(name, entry) from error

    def read_all(self) -> dict[str, NDArray[Any]]:
        """Read all arrays, by name; errors as `read`."""
        return {name: self.read(name) for name in self.names}

    def entry(self) -> dict[str, Any]:
        """Describe the bundle for a manifest: its digest, and dtype and shape of its arrays."""
        of = ("dtype", "shape")
        arrays = {name: {key: about[key] for key in of} for name, about in self._entries.items()}
        return {"digest": self.digest, "arrays": arrays}

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays in memory."""
        return sum(prod(self.shape(name)) * self.dtype(name).itemsize for name in self.names)

    @property
    def nbytes_stored(self) -> int:
        """Bytes on disk, or where it lies; those in memory where a web server doesn't tell."""
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
    """Write a bundle, complete or not at all; takes the place of an older one.

    It is written beside its place and renamed, so that an interrupted write leaves nothing, or
    the older bundle. Equal arrays and attributes give identical bytes. Nothing waits for the disk
    (a sync a file would take longer than the writing): what a power cut damages, the digests show.

    Parameters
    ----------
    path
        Its folder.
    arrays
        Boolean, integer or float arrays of any shape, also of length 0. Few and flat is quick:
        an array costs about 3 ms and two files.
    attributes
        Plain data: units, versions, fingerprints.
    small
        Whether to compress harder, see `rfpipe.store.chunks.small_layout`.
    by_parts
        Whether to cut arrays finer, for those who read parts of them by `ArrayBundle.take`.
    resumes
        As in `storage_errors`.

    Returns
    -------
    str
        Digest of all arrays and attributes.

    Raises
    ------
    InputError
        When a name, a dtype or an attribute can't be stored, or something that is no bundle
        stands there.
    LockedError
        When another process writes it.
    StoreError
        When the disk is full or the folder isn't writable; an older bundle stays.
    """
    contiguous = {name: np.asarray(array, order="C") for name, array in sorted(arrays.items())}
    for name, array in contiguous.items():
        if not _NAME.fullmatch(name) or name == METADATA or array.dtype.kind not in "buif":
            raise InputError(
                f"array {name!r} of {array.dtype} can't be stored",
                place=path,
                remedy="expected booleans, integers or floats, and a name of letters, digits, '_', "
                "'.' and '-'",
            )
    entries = {name: _array_entry(array) for name, array in contiguous.items()}
    digest = _bundle_digest(entries, attributes, path)
    header: dict[str, Any] = {
        "kind": _KIND,
        "digest": digest,
        "arrays": entries,
        "attributes": attributes,
    }
    header = plain(header, f"{path}: attributes")
    needed = sum(array.nbytes for array in contiguous.values())
    new = hidden_sibling(path, "new")
    with StoreLock(path), storage_errors(path, "writing arrays", needed, resumes=resumes):
        if path.exists():
            _refuse_foreign(path)
        remove_tree(new)
        try:
            _write_group(new, contiguous, header, small, by_parts)
            remove_tree(path)
            new.rename(path)
        except OSError:
            shutil.rmtree(new, ignore_errors=True)  # to free the space; the next write clears up
            raise
    return digest


def open_arrays(path: Path | Place) -> ArrayBundle:
    """Open a bundle; StoreError when there is none, IntegrityError where metadata are damaged."""
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
    for name, array in arrays.items():
        chunks, shards = _grid(array, by_parts)
        how = small_layout(array.dtype) if small else layout()
        if shards is not None:
            how["compressors"] = [how["compressors"], Crc32cCodec()]
        stored = group.create_array(
            name, shape=array.shape, dtype=array.dtype, chunks=chunks, shards=shards, **how
        )
        if array.size:
            stored[...] = array


def _grid(array: NDArray[Any], by_parts: bool) -> tuple[tuple[int, ...], tuple[int, ...] | None]:
    """Return the shapes of an array's chunks and of its shards, which it may have none of."""
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
    """Never replace what rfpipe didn't write; a damaged bundle is worth nothing."""
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


def _array_entry(array: NDArray[Any]) -> dict[str, Any]:
    return {
        "digest": digest_of(array),
        "dtype": array.dtype.str,
        "shape": list(array.shape),
    }


def _bundle_digest(entries: dict[str, Any], attributes: dict[str, Any], path: Path | Place) -> str:
    return digest_of(canonical_json([entries, attributes], f"{path}: attributes"))
