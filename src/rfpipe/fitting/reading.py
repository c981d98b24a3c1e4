"""Linear light of listed pictures, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.fitting.folder import Listing, default_curve, linear_light, list_pictures
from rfpipe.fitting.series import Float, Series
from rfpipe.pictures.files import Header, Part
from rfpipe.weights import Curve

if TYPE_CHECKING:
    from rfpipe.photometry import CameraModel


def read_series(
    folder: Path,
    *,
    lights: tuple[int, int] | None = None,
    camera: CameraModel | None = None,
    black: Path | None = None,
    transfer: Curve | None = None,
) -> Series:
    """Read pictures and their patterns.

    Parameters
    ----------
    folder, lights, black
        As for `rfpipe.fitting.folder.list_pictures`. Pictures without light are subtracted.
    camera : CameraModel, optional
        Model of the camera, by which brackets are merged, with their variance. By default pictures
        are light, one exposure of each pattern.
    transfer : {"linear", "srgb"}, optional
        Transfer curve of integers in pictures, and in pictures of patterns.

    Raises
    ------
    InputError
        When a picture can't be read or holds NaN, or number, size or channels don't fit together.
    """
    exposures = len(camera.exposures) if camera else 1
    curve = transfer or default_curve(folder)
    listing = list_pictures(folder, lights=lights, exposures=exposures, black=black, curve=curve)
    header = _common_header(listing)
    patterns = _patterns_of(listing)
    lit = np.asarray(patterns.any(axis=(1, 2)))
    dark = [files for files, is_lit in zip(listing.brackets, lit, strict=True) if not is_lit]
    dark += listing.dark
    brackets = [files for files, is_lit in zip(listing.brackets, lit, strict=True) if is_lit]
    if camera:
        radiance, variance = _merged(camera, brackets, header, dark)
    else:
        seconds = [part.header.exposure_s or 0 for bracket in listing.brackets for part in bracket]
        differ = min(seconds) > 0 and max(seconds) > 1.01 * min(seconds)
        radiance = np.stack([_light(part, curve, differ) for [part] in brackets])
        if dark:
            darkness = [_light(part, curve, differ) for [part] in dark]
            radiance -= np.mean(darkness, axis=0, dtype=np.float64).astype(np.float32)
        variance = np.zeros_like(radiance)
    names, shapes = [files[0].name for files in brackets], (header.size, listing.patterns.shape)
    return Series(
        *shapes, patterns[lit], radiance, variance, names, listing.directions,
        listing.validation[lit],
    )  # fmt: skip


def _common_header(listing: Listing) -> Header:
    """Return the header that all pictures share, up to their exposure time; else InputError."""
    parts = [part for bracket in listing.brackets for part in bracket]
    first = parts[0].header
    for part in parts:
        if replace(part.header, exposure_s=None) != replace(first, exposure_s=None):
            raise InputError(
                f"{part}: is {part.header}; {parts[0]} is {first}. All should be alike"
            )
    return first


def _patterns_of(listing: Listing) -> Float:
    """Return all patterns, (K, 1, N), or (K, 3, N) where any is coloured."""
    shape = (*listing.patterns.shape, 3)
    patterns = [
        np.broadcast_to(weights if weights.ndim == 3 else weights[..., None], shape)
        for weights in (read() for read in listing.patterns.readers)
    ]
    stack = np.stack(patterns).reshape(len(patterns), -1, 3).astype(np.float32, copy=False)
    is_coloured = np.ptp(stack, axis=-1).any()
    return np.moveaxis(stack if is_coloured else stack[..., :1], -1, 1)


def _light(part: Part, curve: Curve, over_time: bool) -> Float:
    """Return a picture as light, (C, M), over its exposure time where requested."""
    light = _planar(np.atleast_3d(linear_light(part, curve)))
    return light / np.float32(part.header.exposure_s) if over_time else light


def _planar(image: Float) -> Float:
    """Return (C, M) of (H, W, C)."""
    return np.ascontiguousarray(image.reshape(-1, image.shape[-1]).T)


def _merged(
    camera: CameraModel,
    brackets: Sequence[Sequence[Part]],
    header: Header,
    dark: Sequence[Sequence[Part]],
) -> tuple[Float, Float]:
    """Return merged brackets and their variance, (K, C, M) each."""
    if header.kind != "counts":
        raise InputError(f"{brackets[0][0]}: holds light; the settings' camera counts")
    shape = camera.frame_shape(header.size, header.channels if camera.bayer is None else 3)

    def frames(parts: Sequence[Part]) -> NDArray[Any]:
        return np.stack([part.read().pixels for part in parts]).reshape(shape)

    black: Any = np.full(shape, camera.black_level_counts, np.float32)
    if dark:
        black = np.mean([frames(files) for files in dark], axis=0, dtype=np.float64)
    merge = camera.merging(black.astype(np.float32), max(1, len(dark)))
    merged = [merge(frames(files)[None]) for files in brackets]
    radiance, variance = (
        np.stack([_planar(getattr(image, name)[0]) for image in merged])
        for name in ("radiance", "variance")
    )
    return radiance, variance
