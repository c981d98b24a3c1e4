"""Messages between acquisition server and client, and validated NumPy archives.

A message is an ``.npz`` with arrays as members ``name.npy``, and plain data as a member
``facts.json``. Members are validated before memory is allocated for them, since the sender may be
malicious.
"""

from __future__ import annotations

import io
import json
import os
import stat
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import IO, Annotated, Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import from_json

from rfpipe.array_types import Float
from rfpipe.errors import ConfigError, TransferError
from rfpipe.rigs.base import check_patterns

MEDIA_TYPE = "application/octet-stream"

API = 1
"""Version of the interface."""

_ADVICE = (
    "create one by: (umask 077; python3 -c 'import secrets; print(secrets.token_urlsafe(32))' "
    "> rig.token), and give it by --token-file, or in a run's settings by capture.token_file"
)


_FACTS = "facts.json"
_MOST_MEMBERS = 4096
_MOST_HEADER_BYTES = 1024
_COMPRESSIONS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_DTYPES = frozenset({"|b1", "|u1", "<u2", "<i4", "<i8", "<f4", "<f8"})


class Health(BaseModel):
    """State and version of the server."""

    status: Literal["ok", "stopping"]
    version: str = Field(description="Version of rfpipe.")
    api: int = Field(description="Version of this interface.")


class Metrics(BaseModel):
    """Counters since the server's start."""

    brackets: int = Field(0, description="Number of captured patterns.")
    failures: int = Field(0, description="Number of captures that failed by an error of the rig.")
    last_error: str | None = None


class StatusAnswer(Metrics):
    """Holder of the rig, and counters since the server's start."""

    up_seconds: float
    holder: str | None = Field(description="Name of the client that holds the rig.")
    devices: dict[str, dict[str, int]] = Field(
        default_factory=dict,
        description="Counters of the rig's devices, such as failed frames.",
    )


class RequestLimits(BaseModel):
    """Limits of requests."""

    patterns: int = Field(description="Largest number of patterns in a request.")
    request_bytes: int = Field(description="Largest size of a request's body in bytes.")
    lease_seconds: float = Field(description="Duration of a lease without a heartbeat.")


class RigAnswer(BaseModel):
    """Properties of the rig; see `rfpipe.rigs.Rig`."""

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int
    seconds_per_pattern: float
    sensor: dict[str, Any] = Field(description="The sensor's description.")
    has_arrays: bool = Field(description="Whether the sensor also needs /v1/rig/arrays.")
    description: dict[str, Any] = Field(description="Everything that affects a frame.")
    digest: str = Field(description="Fingerprint of the description.")
    limits: RequestLimits


class LeaseRequest(BaseModel):
    """Request for the rig."""

    model_config = ConfigDict(extra="forbid")

    client: str = Field(
        min_length=1, max_length=100, pattern=r"^[ -~]+$", description="Name of the client."
    )


class LeaseAnswer(BaseModel):
    """Lease of the rig."""

    lease: str = Field(description="Secret, to be sent as the header Rig-Lease.")
    seconds: float = Field(description="Duration without a heartbeat.")


class Message:
    """A message that is written array by array, to hold each array in memory once only.

    Parameters
    ----------
    facts : mapping
        Plain data; numbers are finite.
    deflate : bool
        Whether arrays are compressed, which is useful for patterns of blocks, not for noise.
    """

    def __init__(self, facts: Mapping[str, Any], *, deflate: bool = False) -> None:
        self._compression = zipfile.ZIP_DEFLATED if deflate else zipfile.ZIP_STORED
        self._buffer = io.BytesIO()
        text = json.dumps(facts, allow_nan=False).encode()
        self._write(_FACTS, lambda member: member.write(text))

    def add(self, name: str, array: NDArray[Any]) -> None:
        """Add an array of bool, uint8, uint16, int32, int64, float32 or float64."""
        plain = np.asarray(array, array.dtype.newbyteorder("<"), order="C")
        self._write(
            f"{name}.npy",
            lambda member: npy.write_array(member, plain, version=(1, 0), allow_pickle=False),
        )

    def content(self) -> bytes:
        """Bytes of the message with the arrays added so far."""
        return self._buffer.getvalue()

    def _write(self, name: str, write: Callable[[IO[bytes]], object]) -> None:
        # the archive is complete after each member, so that a message may end at any time
        archive = zipfile.ZipFile(self._buffer, "a", self._compression, compresslevel=1)
        with archive, archive.open(name, "w", force_zip64=True) as member:
            write(member)


def pack_message(
    facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], *, deflate: bool = False
) -> bytes:
    """Write a message of facts and arrays; see `Message`."""
    message = Message(facts, deflate=deflate)
    for name, array in arrays.items():
        message.add(name, array)
    return message.content()


def unpack_message(message: bytes, limit: int) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read the facts and arrays of a message, and verify their checksums.

    `limit` is the largest total size of the arrays in bytes, after decompression.

    Raises
    ------
    TransferError
        When the message is malformed, cut off, too large or altered.
    """
    # each listed member takes half a kilobyte when the archive is opened
    if message.count(b"PK\x01\x02") > _MOST_MEMBERS:
        raise TransferError(f"the message has more than {_MOST_MEMBERS} members")
    try:
        with zipfile.ZipFile(io.BytesIO(message)) as archive:
            members = {member.filename: member for member in archive.infolist()}
            if len(members) != len(archive.infolist()):
                raise ValueError("two members have the same name")
            # other compression methods allocate memory according to a header
            if {member.compress_type for member in members.values()} - _COMPRESSIONS:
                raise ValueError("a member is compressed by another method than deflate")
            facts_member = members.pop(_FACTS)
            sizes = sum(member.file_size for member in members.values())
            if facts_member.file_size > 2**20 or sizes > limit + _MOST_HEADER_BYTES * len(members):
                raise ValueError(f"it is larger than the {limit} bytes allowed")
            facts = from_json(archive.read(facts_member), allow_inf_nan=False)
            if not isinstance(facts, dict):
                raise ValueError(f"{_FACTS} is not a JSON object")
            return facts, {
                name.removesuffix(".npy"): _array(archive.read(member))
                for name, member in members.items()
            }
    except Exception as error:  # malformed bytes may raise any error in the parsers
        reason = f"{type(error).__name__}: {error}"[:200]
        raise TransferError(f"the message is not an .npz of plain arrays: {reason}") from error


def _array(content: bytes) -> NDArray[Any]:
    """Read the array of a ``.npy`` file, as a view of its bytes."""
    file = io.BytesIO(content)
    if npy.read_magic(file) != (1, 0):
        raise ValueError("an array is a .npy file of another version than (1, 0)")
    shape, is_fortran, dtype = npy.read_array_header_1_0(file)
    if (
        dtype.str not in _DTYPES
        or is_fortran
        or len(content) - file.tell() != (prod(shape) * dtype.itemsize)
    ):
        raise ValueError(
            f"an array of {str(dtype)[:60]} {str(shape)[:60]} is incomplete, or has another type"
        )
    return np.frombuffer(content, dtype, offset=file.tell()).reshape(shape)


@dataclass(frozen=True)
class PackedPatterns:
    """Patterns as sent by `encode_patterns`, as bits or float32.

    Attributes
    ----------
    array : ndarray of uint8, shape (B, bytes), or of float32, shape (B, *projector_shape)
    projector_shape : tuple of int
    keys : list of tuple of int
    """

    array: NDArray[Any]
    projector_shape: tuple[int, ...]
    keys: list[tuple[int, ...]]

    def __len__(self) -> int:
        return len(self.keys)

    def expanded(self, first: int, last: int) -> Float:
        """Weights of the patterns [first, last), float32 (last - first, *projector_shape)."""
        weights = self.array[first:last]
        if weights.dtype == np.uint8:
            weights = np.unpackbits(weights, axis=1, count=prod(self.projector_shape))
        return np.asarray(weights, np.float32).reshape(-1, *self.projector_shape)


def encode_patterns(patterns: Float, keys: Sequence[Sequence[int]]) -> bytes:
    """Write a request for brackets of patterns (B, *projector_shape), without loss.

    Binary patterns are sent as compressed bits, others as float32.
    """
    lit = patterns == 1
    is_binary = bool((lit | (patterns == 0)).all())
    array = np.packbits(lit.reshape(len(patterns), -1), axis=1) if is_binary else patterns
    facts = {"keys": [[int(part) for part in key] for key in keys]}
    return pack_message(facts, {"patterns": array}, deflate=is_binary)


def decode_patterns(
    message: bytes, projector_shape: tuple[int, ...], count_limit: int, byte_limit: int
) -> PackedPatterns:
    """Read and validate the patterns and keys of `encode_patterns`.

    Raises
    ------
    TransferError
        When the message is malformed, its arrays have more than `byte_limit` bytes, patterns have a
        wrong shape, there are more than `count_limit` of them, or a key isn't a list of 1 to 8
        integers in [0, 2**32).
    InputError
        When a weight isn't in [0, 1].
    """
    facts, arrays = unpack_message(message, byte_limit)
    try:
        sent = _Facts.model_validate(facts)
    except ValidationError as error:
        wrong = error.errors(include_url=False, include_input=False)[0]
        raise TransferError(f"the message's keys: {wrong['loc']}: {wrong['msg']}") from None
    if list(arrays) != ["patterns"]:
        raise TransferError("the message must hold the one array 'patterns'")
    if not 1 <= len(sent.keys) <= count_limit:
        raise TransferError(
            f"the request has {len(sent.keys)} patterns",
            remedy=f"send 1 to {count_limit} in a request",
        )
    array, keys = arrays["patterns"], [tuple(key) for key in sent.keys]
    bits, floats = (len(keys), -(-prod(projector_shape) // 8)), (len(keys), *projector_shape)
    if (array.dtype.str, array.shape) not in (("|u1", bits), ("<f4", floats)):
        raise TransferError(
            f"the patterns are {array.dtype.str} {array.shape}; expected |u1 {bits} or <f4 {floats}"
        )
    if array.dtype == np.float32:
        check_patterns(array, keys, projector_shape)
    return PackedPatterns(array, projector_shape, keys)


_KeyPart = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
_Key = Annotated[list[_KeyPart], Field(min_length=1, max_length=8)]


class _Facts(BaseModel):
    """Facts of a request for brackets."""

    keys: Annotated[list[_Key], Field(max_length=_MOST_MEMBERS)]


def read_token(file: Path | None = None) -> str:
    """Read the bearer token from a file or from the environment variable RFPIPE_TOKEN.

    The file contains the token only, 16 to 512 visible ASCII characters, and is readable by its
    owner only.

    Raises
    ------
    ConfigError
        When the token is missing, too short, too long or has other characters, or when others may
        read the file. No message contains the token.
    """
    source, token = "the environment variable RFPIPE_TOKEN", os.environ.get("RFPIPE_TOKEN", "")
    if file is not None:
        source = str(file)
        try:
            with file.open(encoding="utf-8") as opened:
                mode, token = stat.S_IMODE(os.fstat(opened.fileno()).st_mode), opened.read(1024)
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(
                f"{file}: can't be read as a token file: {error}; {_ADVICE}"
            ) from error
        if os.name == "posix" and mode & 0o077:
            raise ConfigError(
                f"{file}: has the mode {mode:o}, so that other users may read the token",
                remedy=f"run: chmod 600 {file}",
            )
        token = token.strip()
    elif not token:
        raise ConfigError(f"{source} is not set and no token file is given; {_ADVICE}")
    is_visible = token.isascii() and all(33 <= ord(character) <= 126 for character in token)
    if not is_visible or not 16 <= len(token) <= 512:
        raise ConfigError(
            f"{source}: has a token of {len(token)} characters; expected 16 to 512 ASCII letters, "
            f"digits and signs without spaces; {_ADVICE}"
        )
    return token
