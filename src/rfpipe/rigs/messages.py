"""Messages between the acquisition server and its client: numpy archives that are checked.

A message is an ``.npz``: an array is a member ``name.npy``, and plain facts are a member
``facts.json``. `numpy.load` reads it, too. Here its members are checked before anything is
allocated for them, since whoever sends one may lie.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable, Mapping
from math import prod
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from rfpipe.errors import TransferError

__all__ = ["MEDIA_TYPE", "Message", "pack", "unpack"]

MEDIA_TYPE = "application/octet-stream"

_FACTS = "facts.json"
_MOST_FACTS_BYTES = 2**20
_MOST_MEMBERS = 4096
_MOST_AXES = 8
_MOST_EXTENT = 2**40
_MOST_HEADER_BYTES = 1024
_DTYPES = frozenset({"|b1", "|u1", "<u2", "<i4", "<i8", "<f4", "<f8"})
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others allocate as a header tells
_DIRECTORY_ENTRY = b"PK\x01\x02"


class Message:
    """A message that is written array by array, so that nothing has to be held twice.

    Parameters
    ----------
    facts : mapping
        Plain data of finite numbers.
    deflate : bool
        Whether to compress the arrays: blocks shrink to almost nothing, noise doesn't shrink.
    """

    def __init__(self, facts: Mapping[str, Any], *, deflate: bool = False) -> None:
        self._how = zipfile.ZIP_DEFLATED if deflate else zipfile.ZIP_STORED
        self._buffer = io.BytesIO()
        self._write(
            _FACTS, lambda member: member.write(json.dumps(facts, allow_nan=False).encode())
        )

    def add(self, name: str, array: NDArray[Any]) -> None:
        """Add an array: booleans, unsigned 8 or 16 bit, signed 32 or 64 bit integers, or floats."""
        plain = np.asarray(array, array.dtype.newbyteorder("<"), order="C")
        self._write(
            f"{name}.npy",
            lambda member: npy.write_array(member, plain, version=(1, 0), allow_pickle=False),
        )

    def content(self) -> bytes:
        """Return the message with the arrays that are in it so far."""
        return self._buffer.getvalue()

    def _write(self, name: str, write: Callable[[IO[bytes]], object]) -> None:
        # whole after each member, so that a message may be given up at any time
        archive = zipfile.ZipFile(self._buffer, "a", self._how, compresslevel=1)
        with archive, archive.open(name, "w", force_zip64=True) as member:
            write(member)


def pack(
    facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, deflate: bool = False
) -> bytes:
    """Return a message; see `Message`."""
    message = Message(facts, deflate=deflate)
    for name, array in arrays.items():
        message.add(name, array)
    return message.content()


def unpack(message: bytes, most_bytes: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the facts and arrays of a message, checked against their checksums.

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
        Read-only.

    Raises
    ------
    TransferError
        When the message is no such one, is cut off, too large or altered.
    """
    # each member that is listed takes half a kilobyte once the archive is opened
    if message.count(_DIRECTORY_ENTRY) > _MOST_MEMBERS:
        raise TransferError(f"the message has more than {_MOST_MEMBERS} members")
    try:
        with zipfile.ZipFile(io.BytesIO(message)) as archive:
            members = _checked(archive.infolist(), most_bytes)
            facts = _facts(archive.read(members.pop(_FACTS)))
            return facts, {
                name.removesuffix(".npy"): _array(archive.read(member))
                for name, member in members.items()
            }
    except TransferError:
        raise
    except Exception as error:  # whatever the parsers make of bytes that are no message
        reason = f"{type(error).__name__}: {error}"[:200]
        raise TransferError(f"the message is no .npz of plain arrays: {reason}") from error


def _checked(members: list[zipfile.ZipInfo], most_bytes: int) -> dict[str, zipfile.ZipInfo]:
    """Return members by name, which must be as few and small as they may be."""
    by_name = {member.filename: member for member in members}
    if len(by_name) != len(members) or _FACTS not in by_name:
        raise TransferError(f"the message needs one member {_FACTS} and no name twice")
    for name, member in by_name.items():
        if member.compress_type not in _COMPRESSIONS:
            raise TransferError(f"{name[:60]!r} is compressed in another way than by deflate")
    if by_name[_FACTS].file_size > _MOST_FACTS_BYTES:
        raise TransferError(f"{_FACTS} is longer than {_MOST_FACTS_BYTES} bytes")
    arrays = [member for name, member in by_name.items() if name != _FACTS]
    allowed = most_bytes + _MOST_HEADER_BYTES * len(arrays)
    if sum(member.file_size for member in arrays) > allowed:
        raise TransferError(f"the message's arrays are larger than the {most_bytes} bytes allowed")
    return by_name


def _facts(content: bytes) -> dict[str, Any]:
    try:
        facts = json.loads(content, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise TransferError(f"{_FACTS} is no JSON of finite numbers: {error}") from None
    if not isinstance(facts, dict):
        raise TransferError(f"{_FACTS} must be a JSON object")
    return facts


def _no_constant(name: str) -> float:
    raise ValueError(f"it holds {name}")


def _array(content: bytes) -> NDArray[Any]:
    """Return the array of a ``.npy`` file, a view of it."""
    header = io.BytesIO(content[:_MOST_HEADER_BYTES])
    version = npy.read_magic(header)
    if version != (1, 0):
        raise TransferError(f"an array is a .npy file of version {version}; expected (1, 0)")
    shape, is_fortran, dtype = npy.read_array_header_1_0(header)
    if dtype.str not in _DTYPES or is_fortran:
        raise TransferError(f"an array is of the type {str(dtype)[:60]}, or by columns")
    is_possible = all(type(n) is int and n >= 0 for n in shape) and len(shape) <= _MOST_AXES
    # an extent of nothing doesn't excuse the others: numpy can't make such an array, either
    if not is_possible or prod(max(1, extent) for extent in shape) > _MOST_EXTENT:
        raise TransferError(f"an array of the shape {str(shape)[:60]} is impossible")
    start = header.tell()
    if len(content) - start != prod(shape) * dtype.itemsize:
        raise TransferError(
            f"an array of {dtype.str} {shape} has {len(content) - start} bytes; expected "
            f"{prod(shape) * dtype.itemsize}"
        )
    return np.frombuffer(content, dtype, offset=start).reshape(shape)
