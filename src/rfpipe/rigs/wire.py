"""Patterns on their way to the acquisition server: all that they tell, in few bytes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from rfpipe.errors import TransferError
from rfpipe.rigs.base import check_patterns
from rfpipe.rigs.messages import pack, unpack

__all__ = ["SentPatterns", "decode_patterns", "encode_patterns"]

Float = NDArray[np.float32]
Kind = Literal["labels", "bits", "levels", "weights"]

_MOST_KEY_PARTS = 8
_MOST_PATTERNS = 4096
_LABELS = ((255, np.uint8), (2**16 - 1, np.uint16))


@dataclass(frozen=True)
class SentPatterns:
    """Patterns as they were sent, of which a few at a time are expanded.

    Attributes
    ----------
    kind : str
    array : ndarray
        As `encode_patterns` tells patterns of that kind.
    projector_shape : tuple of int
    keys : list of tuple of int
        A key for each pattern.
    """

    kind: Kind
    array: NDArray[Any]
    projector_shape: tuple[int, ...]
    keys: list[tuple[int, ...]]

    def __len__(self) -> int:
        return len(self.keys)

    def expanded(self, first: int, last: int) -> Float:
        """Return patterns [first, last) as weights, (last - first, *projector_shape)."""
        if self.kind == "labels":
            numbers = np.arange(first + 1, last + 1).reshape(-1, *(1,) * self.array.ndim)
            return np.asarray(self.array[None] == numbers, np.float32)
        some = self.array[first:last]
        if self.kind == "levels":
            return _of_levels(some)
        if self.kind == "bits":
            bits = np.unpackbits(some, axis=1, count=prod(self.projector_shape))
            return bits.astype(np.float32).reshape(-1, *self.projector_shape)
        return np.asarray(some, np.float32)


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
    facts = {"patterns": kind, "keys": [[int(part) for part in key] for key in keys]}
    return pack(facts, {"patterns": array}, deflate=kind in ("labels", "bits"))


def decode_patterns(
    message: bytes, projector_shape: tuple[int, ...], most: int, most_bytes: int
) -> SentPatterns:
    """Return the patterns and keys of `encode_patterns`, checked but not yet expanded.

    Parameters
    ----------
    message : bytes
    projector_shape : tuple of int
    most : int
        Patterns that may come at a time.
    most_bytes : int
        Bytes that the patterns may take as they are sent, after decompression.

    Raises
    ------
    TransferError
        When the message is malformed, has patterns of another shape or too many of them, or keys
        that aren't a list of 1 to 8 integers in [0, 2**32) each.
    InputError
        When a weight isn't in [0, 1].
    """
    facts, arrays = unpack(message, most_bytes)
    sent = _parsed(facts)
    if list(arrays) != ["patterns"]:
        raise TransferError("the message must hold the one array 'patterns'")
    if not 1 <= len(sent.keys) <= most:
        raise TransferError(f"{len(sent.keys)} patterns; this rig shows 1 to {most} a request")
    array, keys = arrays["patterns"], [tuple(key) for key in sent.keys]
    _check_form(sent.patterns, array, (len(keys), *projector_shape))
    if sent.patterns == "weights":
        check_patterns(array, keys, projector_shape)
    return SentPatterns(sent.patterns, array, projector_shape, keys)


_KeyPart = Annotated[int, Field(strict=True, ge=0, lt=2**32)]
_Key = Annotated[list[_KeyPart], Field(min_length=1, max_length=_MOST_KEY_PARTS)]


class _Facts(BaseModel):
    """What a message says of its patterns."""

    patterns: Kind
    keys: Annotated[list[_Key], Field(max_length=_MOST_PATTERNS)]


def _parsed(facts: dict[str, Any]) -> _Facts:
    """Return facts as they must be, or say what is wrong with the first that isn't so."""
    try:
        return _Facts.model_validate(facts)
    except ValidationError as error:
        wrong = error.errors(include_url=False)[0]
        place = ".".join(map(str, wrong["loc"]))
        value = repr(wrong["input"])[:60]
        raise TransferError(f"the message's facts: {place} is {value}: {wrong['msg']}") from None


def _check_form(kind: Kind, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Raise TransferError where an array can't tell patterns of this kind and shape."""
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
    if kind == "labels" and int(array.max(initial=0)) > count:
        raise TransferError(f"a ray belongs to pattern {array.max()} of {count}")


def _compact(patterns: Float) -> tuple[Kind, NDArray[Any]]:
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


def _of_levels(levels: NDArray[np.uint8]) -> Float:
    return np.asarray(np.divide(levels, 255, dtype=np.float32))
