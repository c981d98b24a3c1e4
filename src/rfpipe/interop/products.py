"""Products of a transport with patterns of any leading axes, shared by all frameworks."""

from __future__ import annotations

from math import prod
from typing import Any

from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.transport.relightable import Relightable


def is_white(transport: Relightable, shape: tuple[int, ...]) -> bool:
    """Return True for patterns (..., *projector_shape), False if an axis of channels follows.

    A shape that fits both has channels. InputError if it fits neither.
    """
    colour = (*transport.projector_shape, transport.channels)
    if shape[-len(colour) :] == colour:
        return False
    if shape[1 - len(colour) :] == colour[:-1]:
        return True
    raise InputError(
        f"a pattern has the shape {tuple(shape)}; expected {colour[:-1]} or {colour}, after any "
        "axes of a batch"
    )


def image_shape(transport: Relightable, shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the shape of the images of patterns (..., *projector_shape, channels)."""
    batch = shape[: -len(transport.projector_shape) - 1]
    return (*batch, *transport.camera_shape, transport.channels)


def relit(transport: Relightable, patterns: NDArray[Any]) -> Float:
    """Relight with patterns (..., *projector_shape, channels)."""
    images = image_shape(transport, patterns.shape)
    count = prod(images[: -len(transport.camera_shape) - 1])
    batch = patterns.reshape(count, *transport.projector_shape, transport.channels)
    return transport.relight_batch(batch).reshape(images)
