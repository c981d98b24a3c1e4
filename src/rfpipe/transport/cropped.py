"""A transport between some of its rays: a view of a light field, a part of a picture."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.transport.base import Float, Light

__all__ = ["CroppedTransport", "crop"]


def crop(whole: Light, camera: Any = None, projector: Any = None) -> CroppedTransport:
    """Return a transport between some of its rays: of a view, of a part of a picture.

    What passes between the others isn't read where the method keeps it apart: by ``symmetric``,
    and, for the camera's rays, by ``footprints``. Others are read whole, for the same pictures.

    Parameters
    ----------
    whole : Transport
        Or a dual one.
    camera, projector : int, slice or tuple of them, optional
        Which rays, as an index of an array of its `camera_shape` or `projector_shape` that leaves
        height and width: ``4`` for the view 4 of several, ``np.s_[4, 10:20, :]`` for some rows of
        it. All by default.

    Returns
    -------
    CroppedTransport
        Of the shapes that are left.

    Raises
    ------
    InputError
        If there are no such rays.
    """
    seen = _rays(camera, whole.camera_shape, "camera")
    lit = _rays(projector, whole.projector_shape, "projector")
    needed = whole.between_some(_mask(seen, whole.camera_shape), _mask(lit, whole.projector_shape))
    return CroppedTransport(needed, seen, lit)


class CroppedTransport(Light):
    """What `crop` returns.

    Parameters
    ----------
    whole : Light
        Of which what passes between the other rays may be missing.
    seen, lit : ndarray of int64
        The camera's and the projector's rays, in the shape that they have here.
    """

    def __init__(self, whole: Light, seen: NDArray[np.int64], lit: NDArray[np.int64]) -> None:
        self._whole, self._seen, self._lit = whole, seen, lit
        self.camera_shape, self.projector_shape = seen.shape, lit.shape
        self.channels = whole.channels

    def __repr__(self) -> str:
        return f"{self._whole!r} between {self.camera_shape} and {self.projector_shape} of its rays"

    def forward(self, patterns: Float, channels: Sequence[int]) -> Float:
        """Return ``T p`` for planar patterns ``(P, K, N)``."""
        light = _spread(patterns, self._lit, prod(self._whole.projector_shape))
        return self._whole.forward(light, channels)[..., self._seen.reshape(-1)]

    def adjoint(self, images: Float, channels: Sequence[int]) -> Float:
        """Return ``T^T c`` for planar images ``(P, K, M)``."""
        light = _spread(images, self._seen, prod(self._whole.camera_shape))
        return self._whole.adjoint(light, channels)[..., self._lit.reshape(-1)]


def _rays(chosen: Any, shape: tuple[int, ...], name: str) -> NDArray[np.int64]:
    every = np.arange(prod(shape), dtype=np.int64).reshape(shape)
    if chosen is None:
        return every
    parts = chosen if isinstance(chosen, tuple) else (chosen,)
    plain = all(part is Ellipsis or isinstance(part, int | np.integer | slice) for part in parts)
    try:
        found: Any = every[parts] if plain else None
    except IndexError:
        found = None
    if found is None or found.ndim < 2 or not found.size:
        raise InputError(
            f"{name} = {chosen!r} of rays {shape}: expected whole numbers and slices that leave "
            "height and width, such as 4 for the view 4 of several, or np.s_[4, 10:20, :] for "
            "some rows of it"
        )
    return np.asarray(found)


def _mask(rays: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    mask = np.zeros(prod(shape), bool)
    mask[rays.reshape(-1)] = True
    return mask


def _spread(planar: Float, rays: NDArray[np.int64], count: int) -> Float:
    """Return planar light of some rays as that of all, white light the same memory a channel."""
    white = planar.strides[1] == 0
    own = planar[:, :1] if white else planar
    light = np.zeros((*own.shape[:2], count), np.float32)
    light[..., rays.reshape(-1)] = own
    return np.broadcast_to(light, (*planar.shape[:2], count))
