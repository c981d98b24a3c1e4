"""What the acquisition server and its client say to each other, and its checked numpy archives.

A message is an ``.npz``: an array is a member ``name.npy``, and plain facts are a member
``facts.json``. Its members are checked before anything is allocated for them, since whoever sends
one may lie.
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

from rfpipe.errors import ConfigError, TransferError
from rfpipe.rigs.base import check_patterns

MEDIA_TYPE = "application/octet-stream"

API = 1
"""Version of the interface."""

_ADVICE = (
    "make one with: (umask 077; python3 -c 'import secrets; print(secrets.token_urlsafe(32))' "
    "> rig.token), and name it by --token-file, or in a run by capture.token_file"
)

Float = NDArray[np.float32]

_FACTS = "facts.json"
_MOST_MEMBERS = 4096
_MOST_HEADER_BYTES = 1024
_COMPRESSIONS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_DTYPES = frozenset({"|b1", "|u1", "<u2", "<i4", "<i8", "<f4", "<f8"})


class Health(BaseModel):
    """That the server is there."""

    status: Literal["ok", "stopping"]
    version: str = Field(description="Version of rfpipe.")
    api: int = Field(description="Version of this interface.")


class Metrics(BaseModel):
    """What happened since the start."""

    brackets: int = Field(0, description="Patterns exposed.")
    failures: int = Field(0, description="Exposures that ended with an error of the rig.")
    last_error: str | None = None


class StatusAnswer(Metrics):
    """Who holds the rig, and what happened since the start."""

    up_seconds: float
    holder: str | None = Field(description="What the client that holds the rig calls itself.")
    devices: dict[str, dict[str, int]] = Field(
        default_factory=dict,
        description="What the rig's devices counted, such as failed frames, of those that count.",
    )


class Limits(BaseModel):
    """What a client has to keep to."""

    patterns: int = Field(description="Patterns in a request.")
    request_bytes: int = Field(description="Bytes of a request's body.")
    lease_seconds: float = Field(description="Time that a lease lasts without a heart-beat.")


class RigAnswer(BaseModel):
    """The rig, as `rfpipe.rigs.Rig` has it."""

    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int
    seconds_per_pattern: float
    sensor: dict[str, Any] = Field(description="The sensor's description.")
    has_arrays: bool = Field(description="Whether the sensor needs /v1/rig/arrays, too.")
    description: dict[str, Any] = Field(description="All that shapes a frame.")
    digest: str = Field(description="Fingerprint of the description.")
    limits: Limits


class LeaseRequest(BaseModel):
    """Who wants the rig."""

    model_config = ConfigDict(extra="forbid")

    client: str = Field(
        min_length=1, max_length=100, pattern=r"^[ -~]+$", description="A name for people to read."
    )


class LeaseAnswer(BaseModel):
    """The right to use the rig."""

    lease: str = Field(description="To be sent as the header Rig-Lease, and told to nobody.")
    seconds: float = Field(description="Time that it lasts without a heart-beat.")


class Message:
    """A message that is written array by array, so that nothing has to be held twice.

    `facts` are plain data of finite numbers. Arrays are compressed where `deflate` asks for it:
    blocks shrink to almost nothing, noise doesn't shrink.
    """

    def __init__(self, facts: Mapping[str, Any], *, deflate: bool = False) -> None:
        self._how = zipfile.ZIP_DEFLATED if deflate else zipfile.ZIP_STORED
        self._buffer = io.BytesIO()
        text = json.dumps(facts, allow_nan=False).encode()
        self._write(_FACTS, lambda member: member.write(text))

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

    All arrays together may take `most_bytes` in memory, so that few compressed bytes can't fill it.

    Raises
    ------
    TransferError
        When the message is no such one, is cut off, too large or altered.
    """
    # each member that is listed takes half a kilobyte once the archive is opened
    if message.count(b"PK\x01\x02") > _MOST_MEMBERS:
        raise TransferError(f"the message has more than {_MOST_MEMBERS} members")
    try:
        with zipfile.ZipFile(io.BytesIO(message)) as archive:
            members = {member.filename: member for member in archive.infolist()}
            if len(members) != len(archive.infolist()):
                raise ValueError("a name is there twice")
            # other compressions allocate as a header says
            if {member.compress_type for member in members.values()} - _COMPRESSIONS:
                raise ValueError("a member is compressed in another way than by deflate")
            told = members.pop(_FACTS)
            allowed = most_bytes + _MOST_HEADER_BYTES * len(members)
            if told.file_size > 2**20 or sum(one.file_size for one in members.values()) > allowed:
                raise ValueError(f"it is larger than the {most_bytes} bytes allowed")
            facts = from_json(archive.read(told), allow_inf_nan=False)
            if not isinstance(facts, dict):
                raise ValueError(f"{_FACTS} is no JSON object")
            return facts, {
                name.removesuffix(".npy"): _array(archive.read(member))
                for name, member in members.items()
            }
    except Exception as error:  # whatever the parsers make of bytes that are no message
        reason = f"{type(error).__name__}: {error}"[:200]
        raise TransferError(f"the message is no .npz of plain arrays: {reason}") from error


def _array(content: bytes) -> NDArray[Any]:
    """Return the array of a ``.npy`` file, a view of it."""
    file = io.BytesIO(content)
    if npy.read_magic(file) != (1, 0):
        raise ValueError("an array is a .npy file of another version than (1, 0)")
    shape, is_fortran, dtype = npy.read_array_header_1_0(file)
    if (
        dtype.str not in _DTYPES
        or is_fortran
        or len(content) - file.tell() != (prod(shape) * dtype.itemsize)
    ):
        raise ValueError(f"an array of {str(dtype)[:60]} {str(shape)[:60]} isn't all there")
    return np.frombuffer(content, dtype, offset=file.tell()).reshape(shape)


@dataclass(frozen=True)
class SentPatterns:
    """Patterns as `encode_patterns` sends them, of which a few at a time are expanded."""

    array: NDArray[Any]
    projector_shape: tuple[int, ...]
    keys: list[tuple[int, ...]]

    def __len__(self) -> int:
        return len(self.keys)

    def expanded(self, first: int, last: int) -> Float:
        """Return patterns [first, last) as weights, (last - first, *projector_shape)."""
        some = self.array[first:last]
        if some.dtype == np.uint8:
            some = np.unpackbits(some, axis=1, count=prod(self.projector_shape))
        return np.asarray(some, np.float32).reshape(-1, *self.projector_shape)


def encode_patterns(patterns: Float, keys: Sequence[Sequence[int]]) -> bytes:
    """Return the message that asks for brackets of patterns (B, *projector_shape), without loss.

    Patterns of ones and zeros go as bits, which deflate makes small; others as float32.
    """
    lit = patterns == 1
    is_binary = bool((lit | (patterns == 0)).all())
    array = np.packbits(lit.reshape(len(patterns), -1), axis=1) if is_binary else patterns
    facts = {"keys": [[int(part) for part in key] for key in keys]}
    return pack(facts, {"patterns": array}, deflate=is_binary)


def decode_patterns(
    message: bytes, projector_shape: tuple[int, ...], most: int, most_bytes: int
) -> SentPatterns:
    """Return the patterns and keys of `encode_patterns`, checked but not yet expanded.

    Raises
    ------
    TransferError
        When the message is malformed, its arrays take over `most_bytes`, has patterns of another
        shape or over `most` of them, or keys that aren't a list of 1 to 8 integers in [0, 2**32)
        each.
    InputError
        When a weight isn't in [0, 1].
    """
    facts, arrays = unpack(message, most_bytes)
    try:
        sent = _Facts.model_validate(facts)
    except ValidationError as error:
        wrong = error.errors(include_url=False, include_input=False)[0]
        raise TransferError(f"the message's keys: {wrong['loc']}: {wrong['msg']}") from None
    if list(arrays) != ["patterns"]:
        raise TransferError("the message must hold the one array 'patterns'")
    if not 1 <= len(sent.keys) <= most:
        raise TransferError(f"{len(sent.keys)} patterns; this rig shows 1 to {most} a request")
    array, keys = arrays["patterns"], [tuple(key) for key in sent.keys]
    bits, whole = (len(keys), -(-prod(projector_shape) // 8)), (len(keys), *projector_shape)
    if (array.dtype.str, array.shape) not in (("|u1", bits), ("<f4", whole)):
        raise TransferError(
            f"the patterns are {array.dtype.str} {array.shape}; expected |u1 {bits} or <f4 {whole}"
        )
    if array.dtype == np.float32:
        check_patterns(array, keys, projector_shape)
    return SentPatterns(array, projector_shape, keys)


_KeyPart = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
_Key = Annotated[list[_KeyPart], Field(min_length=1, max_length=8)]


class _Facts(BaseModel):
    """What a message says of its patterns."""

    keys: Annotated[list[_Key], Field(max_length=_MOST_MEMBERS)]


def read_token(file: Path | None = None) -> str:
    """Read the bearer token from a file or from the environment; never from a command line.

    The file holds nothing but the token, 16 to 512 visible ASCII characters, and nobody but its
    owner may read it.

    Raises
    ------
    ConfigError
        When there is none, others may read the file, or the token is too short, too long or holds
        other characters. No message shows it.
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
                f"{file}: has the mode {mode:o}, so that others may read the token; run: "
                f"chmod 600 {file}"
            )
        token = token.strip()
    elif not token:
        raise ConfigError(f"{source} is not set and no token file is named; {_ADVICE}")
    is_visible = token.isascii() and all(33 <= ord(character) <= 126 for character in token)
    if not is_visible or not 16 <= len(token) <= 512:
        raise ConfigError(
            f"{source}: holds a token of {len(token)} characters; expected 16 to 512 ASCII "
            f"letters, digits and signs without spaces; {_ADVICE}"
        )
    return token
