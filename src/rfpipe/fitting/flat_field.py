"""Uneven light of single lights, divided out by pictures of a white card in the object's place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rfpipe.errors import InputError
from rfpipe.fitting.series import Series
from rfpipe.lights.interpolation import unit

_DARKEST = 0.01
"""Light of the card, over its median, below which a pixel is unknown."""


def flat_fielded(series: Series, card: Series) -> Series:
    """Divide pictures of single lights by those of a matt white card that faces the camera.

    Parameters
    ----------
    series : Series
        Pictures of the object under single lights with known directions.
    card : Series
        Pictures of the card under the same lights, in the same order, size and channels.

    Returns
    -------
    Series
        Pictures under lights that are even, of equal power and colour, and without fall-off, in
        about the same unit. Pixels where the card is dark are unknown.

    Raises
    ------
    InputError
        If directions are unknown, a light is behind the card, or the pictures are not alike.

    Notes
    -----
    A card under a distant light ``l`` of power ``p`` has the radiance ``a p l_z``, with its albedo
    ``a``; so pictures are multiplied by ``l_z`` over the card's radiance.
    """
    if series.lights is None:
        raise InputError("a flat field needs single lights with a file of their directions")
    if (card.camera_shape, card.radiance.shape) != (series.camera_shape, series.radiance.shape):
        first, second = ((*one.radiance.shape[:2], *one.camera_shape) for one in (card, series))
        raise InputError(
            f"the flat field has the shape {first} (pictures, channels, height, width); expected "
            f"{second}, a picture of the white card for each light"
        )
    z = unit(series.lights[series.patterns[:, 0].argmax(axis=1)])[:, 2, None, None]
    if z.min() <= 0:
        name = series.names[int(z.argmin())] if series.names else f"picture {int(z.argmin())}"
        raise InputError(
            f"{name}: its light has z = {z.min():.2g}, behind a card that faces the camera; leave "
            "this picture out, or fit without the flat field"
        )
    typical = np.median(card.radiance[..., card.known] / z) if card.known.any() else 0
    known = card.known & (card.radiance > _DARKEST * typical * z).all(axis=(0, 1))
    if not known.any():
        raise InputError("the white card is dark or saturated everywhere")
    gain = np.where(known, typical * z / np.where(known, card.radiance, 1), 0).astype(np.float32)
    variance = np.where(known, np.where(known, series.variance, 0) * gain**2, np.inf)
    return replace(series, radiance=series.radiance * gain, variance=variance.astype(np.float32))
