"""How arrays are laid out in zarr: chunks, names and compression."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.store.files import storage_errors
from rfpipe.store.places import Place

__all__ = [
    "DAMAGE",
    "METADATA",
    "Compression",
    "compression_for",
    "damaged_metadata",
    "layout",
    "read_attributes",
    "small_layout",
]

Compression = Literal["zstd", "lz4", "none"]
Shuffle = Literal["bitshuffle", "shuffle"]
Layout = dict[str, Any]

METADATA = "zarr.json"

# An all-black frame is a frame: zarr would leave out chunks that are all fill value.
_CONFIG: Any = {"write_empty_chunks": True}

DAMAGE = (OSError, RuntimeError, ValueError, KeyError, TypeError)
"""What zarr and its codecs raise on damaged bytes."""


def compression_for(dtype: np.dtype[Any]) -> Compression:
    """Compression that suits a dtype: zstd for integers, lz4 for floats.

    Counts and indices have empty high bits, which zstd packs 15 % tighter. The low bits of
    radiance are noise: lz4 packs them as tightly to 3 %, in half the time.
    """
    return "lz4" if dtype.kind == "f" else "zstd"


def layout(compression: Compression, *, level: int = 1, shuffle: Shuffle = "bitshuffle") -> Layout:
    """Keyword arguments, for zarr's ``create_array``, that all arrays share."""
    from zarr.codecs import BloscCodec

    return {
        "compressors": None
        if compression == "none"
        else BloscCodec(cname=compression, clevel=level, shuffle=shuffle),
        "fill_value": 0,
        # All chunks of an array in one folder: no folder a chunk.
        "chunk_key_encoding": {"name": "default", "separator": "."},
        "config": _CONFIG,
    }


def small_layout(dtype: np.dtype[Any]) -> Layout:
    """`layout` of arrays that are written once and kept: smaller, in three times the time.

    Indices that mostly ascend pack four times as tightly by bytes as by bits, numbers don't.
    """
    is_index = dtype.kind in "iu" and dtype.itemsize >= 4
    return layout("zstd", level=5, shuffle="shuffle" if is_index else "bitshuffle")


def read_attributes(path: Path | Place, kind: str) -> dict[str, Any]:
    """Attributes of a store that rfpipe wrote, read without zarr.

    Parameters
    ----------
    path
        The store's folder.
    kind
        What is expected there, the value of its attribute ``"kind"``.

    Raises
    ------
    StoreError
        When there is no store, or one of another kind.
    IntegrityError
        When its metadata are damaged.
    """
    metadata = path / METADATA
    if isinstance(metadata, Path) and not metadata.is_file():
        raise StoreError(f"{path}: no store of {kind} here; run the stage that writes it")
    content = _read(metadata, kind)
    try:
        attributes = json.loads(content)["attributes"]
        found = attributes["kind"]
    except (ValueError, KeyError, TypeError) as error:
        raise damaged_metadata(path, error) from error
    if found != kind:
        raise StoreError(f"{path}: a store of {found!r}; expected one of {kind!r}")
    return dict(attributes)


def _read(metadata: Path | Place, kind: str) -> bytes:
    if isinstance(metadata, Path):
        with storage_errors(metadata, "reading"):
            return metadata.read_bytes()
    try:
        return metadata.read_bytes()
    except FileNotFoundError as error:
        raise StoreError(
            f"{metadata}: no such file, so no store of {kind}; check the address"
        ) from error


def damaged_metadata(path: Path | Place, error: Exception) -> IntegrityError:
    """Error that names a store's damaged metadata and says what to do."""
    advice = (
        f"restore this file, or remove {path} and run the stage that writes it again"
        if isinstance(path, Path)
        else "check that the address gives this file and no page for people, or fetch it anew"
    )
    return IntegrityError(
        f"{path / METADATA}: damaged metadata ({type(error).__name__}: {error}); {advice}"
    )
