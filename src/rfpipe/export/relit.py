"""Many pictures relit: each in a file, or all in a movie."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.export.movies import write_movie
from rfpipe.export.paths import LightPath
from rfpipe.export.scales import Scale
from rfpipe.pictures.images import srgb
from rfpipe.transport.base import Light

Float = NDArray[np.float32]

_WHITE = 99.9  # per cent of a frame's samples that are not cut off


def relit_pictures(
    light: Light, patterns: Iterable[Float], scale: Scale | None = None, view: int | None = None
) -> Iterator[Float]:
    """Yield the pictures under patterns, a few at a time in memory.

    Patterns are as `Light.relight` takes them. Of several views one is shown, `view`, or all, one
    above the other.

    Yields
    ------
    ndarray of float32, shape (H, W, C)
        Radiance.

    Raises
    ------
    InputError
        If there is no such view, or a pattern isn't one.
    """
    domain, scale = RayDomain(light.camera_shape), scale or Scale()
    if view is not None and not 0 <= view < domain.views:
        raise InputError(f"view {view}: the camera's rays have views 0 to {domain.views - 1}")
    for pattern in patterns:
        stack = light.relight(pattern).reshape(*domain.stack_shape, light.channels)
        shown = stack.reshape(*domain.picture_shape, -1) if view is None else stack[view]
        yield scale.apply(shown)


def relit_movie(
    light: Light,
    path: Path,
    lights: LightPath,
    *,
    fps: float = 25,
    scale: Scale | None = None,
    white: float | None = None,
    view: int | None = None,
    progress: bool = False,
) -> float:
    """Write the movie of a light path; return the radiance shown as white.

    Parameters
    ----------
    light : Light
    path : path
        Ends in ``.mp4`` or ``.webm``.
    lights : LightPath
    fps : float
        Pictures a second.
    scale : Scale, optional
    white : float, optional
        Radiance shown as white; by default all but the brightest thousandth of the samples of the
        brightest picture are shown as they are, for which all is relit twice.
    view : int, optional
        The one of several views to show.
    progress : bool
        Whether to show on stderr how far it is, if that is a terminal.

    Raises InputError and StoreError as `relit_pictures` and `write_movie`.
    """
    from tqdm import tqdm

    def relit(scale: Scale | None, what: str) -> Iterator[Float]:
        patterns = (lights.batch(index, index + 1)[0] for index in range(lights.count))
        pictures = relit_pictures(light, patterns, scale, view)
        bar = tqdm(pictures, what, lights.count, unit="picture", disable=None if progress else True)
        return iter(bar)

    if white is None:
        brightest = (float(np.percentile(image, _WHITE)) for image in relit(None, "white"))
        white = max(brightest) or 1.0
    if not 0 < white < float("inf"):
        raise InputError(f"white is {white}; expected a radiance above 0")
    shown = (np.rint(255 * srgb(image, white)) for image in relit(scale, str(path)))
    write_movie(path, (picture.astype(np.uint8) for picture in shown), fps)
    return white
