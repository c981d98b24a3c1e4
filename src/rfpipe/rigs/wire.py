"""Messages between the acquisition server and its client: plain facts and binary arrays.

A message is the four bytes ``RFP1``, the length of a JSON header as a little-endian uint32, the
header, and the bytes of the arrays in the header's order. Each array has its SHA-256 there.
"""

from __future__ import annotations

import hashlib
import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from math import prod
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from rfpipe.errors import TransferError

__all__ = ["MEDIA_TYPE", "decode_patterns", "encode_patterns", "pack", "unpack"]

Float = NDArray[np.float32]
_Model = TypeVar("_Model", bound=BaseModel)

MEDIA_TYPE = "application/octet-stream"

_MAGIC = b"RFP1"
_PREFIX = struct.Struct("<4sI")
_MOST_HEADER_BYTES = 2**20
_MOST_ARRAYS = 4096
_MOST_AXES = 8
_LABELS = ((255, np.uint8), (2**16 - 1, np.uint16))


def pack(
    facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, deflate: bool = False
) -> bytes:
    """Return a message.

    Parameters
    ----------
    facts : mapping
        Plain data of finite numbers; the key "arrays" is taken.
    arrays : mapping of str to ndarray
        Booleans, unsigned 8 or 16 bit, signed 32 or 64 bit integers, or floats.
    deflate : bool
        Whether to compress the arrays: blocks shrink to almost nothing, noise doesn't shrink.
    """
    entries, payloads = [], []
    for name, array in arrays.items():
        dtype = array.dtype.newbyteorder("<")
        content: Any = np.ascontiguousarray(array, dtype).reshape(-1).view(np.uint8).data
        entry = {
            "name": name,
            "dtype": dtype.str,
            "shape": list(array.shape),
            "sha256": hashlib.sha256(content).hexdigest(),
        }
        if deflate:
            content = zlib.compress(content, level=1)
        entries.append({**entry, "deflate": deflate, "bytes": len(content)})
        payloads.append(content)
    header = json.dumps({**facts, "arrays": entries}, allow_nan=False).encode()
    return b"".join([_PREFIX.pack(_MAGIC, len(header)), header, *payloads])


def unpack(message: bytes, most_bytes: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the facts and arrays of a message, checked against their digests.

    Parameters
    ----------
    message : bytes
    most_bytes : int
        Bytes that all arrays together may take in memory, so that few compressed bytes can't
        fill it.

    Returns
    -------
    facts : dict
    arrays : dict of str to ndarray
        Read-only where they weren't compressed.

    Raises
    ------
    TransferError
        When the message is no such one, is cut off, longer than it says, too large or altered.
    """
    facts, start = _header(message)
    entries = _parsed(_Header, facts, "the message's header").arrays
    del facts["arrays"]
    arrays: dict[str, NDArray[Any]] = {}
    view = memoryview(message)
    for entry in entries:
        name, dtype, shape = entry.name, np.dtype(entry.dtype), tuple(entry.shape)
        if name in arrays:
            raise TransferError(f"the message holds two arrays {name!r}")
        expected = prod(shape) * dtype.itemsize
        most_bytes -= expected
        if most_bytes < 0:
            raise TransferError(f"array {name!r} of shape {shape} is larger than allowed")
        content = view[start : start + entry.bytes]
        start += entry.bytes
        if len(content) < entry.bytes:
            raise TransferError(f"the message ends within array {name!r}")
        plain = _inflated(content, expected, name) if entry.deflate else content
        if len(plain) != expected:
            raise TransferError(f"array {name!r} has {len(plain)} bytes; expected {expected}")
        if hashlib.sha256(plain).hexdigest() != entry.sha256:
            raise TransferError(f"array {name!r} doesn't match its digest: it was altered")
        arrays[name] = np.frombuffer(plain, dtype).reshape(shape)
    if start != len(message):
        raise TransferError(f"the message has {len(message) - start} bytes after its last array")
    return facts, arrays


def encode_patterns(patterns: Float, keys: Sequence[Sequence[int]]) -> bytes:
    """Return the message that asks for brackets of patterns, without loss and compact.

    Parameters
    ----------
    patterns : ndarray of float32, shape (B, *projector_shape)
    keys : sequence of B sequences of int

    Notes
    -----
    Disjoint patterns of ones, as a level of blocks has them, go as one image of pattern numbers;
    other ones and zeros as bits; multiples of 1/255 as bytes; the rest as float32.
    """
    kind, array = _compact(patterns)
    facts = {
        "patterns": kind,
        "shape": list(patterns.shape),
        "keys": [[int(part) for part in key] for key in keys],
    }
    return pack(facts, {"patterns": array}, deflate=kind in ("labels", "bits"))


def decode_patterns(
    message: bytes, projector_shape: tuple[int, ...], most: int
) -> tuple[Float, list[tuple[int, ...]]]:
    """Return the patterns and keys of `encode_patterns`.

    Parameters
    ----------
    message : bytes
    projector_shape : tuple of int
    most : int
        Patterns that may come at a time.

    Raises
    ------
    TransferError
        When the message is malformed, has patterns of another shape or too many of them, or keys
        that aren't a list of 1 to 8 integers in [0, 2**32) each. Weights are the rig's to check.
    """
    facts, arrays = unpack(message, 4 * most * prod(projector_shape))
    sent = _parsed(_Patterns, facts, "the message's header")
    shape = tuple(sent.shape)
    if shape[1:] != projector_shape or not 1 <= shape[0] <= most or len(sent.keys) != shape[0]:
        raise TransferError(
            f"patterns have the shape {shape} and {len(sent.keys)} keys; this rig shows (1 to "
            f"{most}, {', '.join(map(str, projector_shape))}), a key each"
        )
    if list(arrays) != ["patterns"]:
        raise TransferError("the message must hold the one array 'patterns'")
    keys = [tuple(key) for key in sent.keys]
    return _expanded(sent.patterns, arrays["patterns"], shape), keys


def _header(message: bytes) -> tuple[dict[str, Any], int]:
    """Return the header and where the arrays begin."""
    if len(message) < _PREFIX.size:
        raise TransferError(f"the message has {len(message)} bytes; it must begin with a header")
    magic, length = _PREFIX.unpack_from(message)
    if magic != _MAGIC:
        raise TransferError(f"the message begins with {magic!r}; expected {_MAGIC!r}")
    start = _PREFIX.size + length
    if length > _MOST_HEADER_BYTES or start > len(message):
        raise TransferError(f"the message's header has {length} bytes: too many, or cut off")
    try:
        facts = json.loads(message[_PREFIX.size : start], parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise TransferError(f"the message's header is no JSON of finite numbers: {error}") from None
    if not isinstance(facts, dict):
        raise TransferError("the message's header must be a JSON object")
    return facts, start


def _no_constant(name: str) -> float:
    raise ValueError(f"it holds {name}")


_Count = Annotated[int, Field(strict=True, ge=0, lt=2**40)]
_Extents = Annotated[list[_Count], Field(max_length=_MOST_AXES)]
_KeyPart = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
_Key = Annotated[list[_KeyPart], Field(min_length=1, max_length=_MOST_AXES)]


class _Entry(BaseModel):
    """What the header says of an array."""

    name: str
    dtype: Literal["|b1", "|u1", "<u2", "<i4", "<i8", "<f4", "<f8"]
    shape: _Extents
    bytes: _Count
    sha256: str
    deflate: bool = False


class _Header(BaseModel):
    arrays: Annotated[list[_Entry], Field(max_length=_MOST_ARRAYS)]


class _Patterns(BaseModel):
    """What the header says of patterns."""

    patterns: Literal["labels", "bits", "levels", "weights"]
    shape: _Extents
    keys: Annotated[list[_Key], Field(max_length=_MOST_ARRAYS)]


def _parsed(model: type[_Model], facts: dict[str, Any], name: str) -> _Model:
    """Return facts as a model has them, or say what is wrong with the first that isn't so."""
    try:
        return model.model_validate(facts)
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        place = ".".join(map(str, wrong["loc"]))
        raise TransferError(
            f"{name}: {place} is {_brief(wrong['input'])}: {wrong['msg']}"
        ) from None


def _brief(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:60]} ..."


def _inflated(content: memoryview, expected: int, name: str) -> bytes:
    """Decompress to as many bytes as expected, never more."""
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(content, expected + 1)
    except zlib.error as error:
        raise TransferError(f"array {name!r} can't be decompressed: {error}") from None
    if stream.unused_data:
        raise TransferError(f"array {name!r} has bytes after its end")
    return plain


def _compact(patterns: Float) -> tuple[str, NDArray[Any]]:
    """Return the kind and array that tell all of the patterns in the fewest bytes."""
    lit = patterns == 1
    if not (lit | (patterns == 0)).all():
        steps = np.clip(np.nan_to_num(np.rint(patterns * np.float32(255))), 0, 255)
        levels = steps.astype(np.uint8)
        is_exact = np.array_equal(_of_levels(levels), patterns)
        return ("levels", levels) if is_exact else ("weights", np.asarray(patterns, np.float32))
    count = len(patterns)
    for most, dtype in _LABELS:
        if count <= most and np.count_nonzero(lit) == np.count_nonzero(lit.any(axis=0)):
            labels = np.zeros(patterns.shape[1:], dtype)
            for index, pattern in enumerate(lit, start=1):
                labels[pattern] = index
            return "labels", labels
    return "bits", np.packbits(lit.reshape(count, -1), axis=1)


def _expanded(kind: str, array: NDArray[Any], shape: tuple[int, ...]) -> Float:
    """Return the patterns that `_compact` told of."""
    count, rays = shape[0], prod(shape[1:])
    expected = {
        "labels": (("|u1", "<u2"), shape[1:]),
        "bits": (("|u1",), (count, -(-rays // 8))),
        "levels": (("|u1",), shape),
        "weights": (("<f4",), shape),
    }
    dtypes, form = expected[kind]
    if array.dtype.str not in dtypes or array.shape != form:
        raise TransferError(
            f"patterns as {kind} are {array.dtype.str} {array.shape}; expected {dtypes} {form}"
        )
    if kind == "weights":
        return np.asarray(array, np.float32)
    if kind == "levels":
        return _of_levels(array)
    if kind == "bits":
        bits = np.unpackbits(array, axis=1, count=rays)
        return bits.astype(np.float32).reshape(shape)
    if int(array.max(initial=0)) > count:
        raise TransferError(f"a ray belongs to pattern {array.max()} of {count}")
    numbers = np.arange(1, count + 1).reshape(-1, *(1,) * array.ndim)
    lit: Float = (array[None] == numbers).astype(np.float32)
    return lit


def _of_levels(levels: NDArray[np.uint8]) -> Float:
    return np.asarray(np.divide(levels, 255, dtype=np.float32))
