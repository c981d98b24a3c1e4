"""Many pictures relit: each in a file, or all in a movie."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from math import prod
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.export.movies import write_movie
from rfpipe.export.paths import LightPath
from rfpipe.export.scales import Scale
from rfpipe.pictures.images import srgb, write_image
from rfpipe.stages.jobs.progress import Progress
from rfpipe.stages.jobs.workers import Resources
from rfpipe.store.files import storage_errors, whole_file
from rfpipe.transport.base import Light
from rfpipe.transport.storage import open_transport

__all__ = ["Lighting", "open_light", "relit_files", "relit_movie", "relit_pictures"]

Float = NDArray[np.float32]

_WHITE = 99.9  # per cent of a frame's samples that are not cut off
# Patterns relit together, whoever does it: the last bits of a picture depend on it.
_AT_A_TIME = 16
# Copies of a picture while it is relit, scaled and written.
_COPIES = 6

# Relighting has threads of its own, for which this process has one place; pictures are written
# side by side.
_relighting = Lock()


def relit_pictures(
    light: Light, patterns: Iterable[Float], scale: Scale | None = None, view: int | None = None
) -> Iterator[Float]:
    """Yield the pictures under patterns, a few at a time in memory.

    Parameters
    ----------
    light : Light
    patterns : iterable of ndarray, shape (*projector_shape) or (*projector_shape, channels)
        As `Light.relight` takes them.
    scale : Scale, optional
    view : int, optional
        The one of several views to show; all of them, one above the other, by default.

    Yields
    ------
    ndarray of float32, shape (H, W, C)
        Radiance.

    Raises
    ------
    InputError
        If there is no such view, or a pattern isn't one.
    """
    _check_view(light, view)
    yield from _shown(light, map(light.relight, patterns), scale or Scale(), view)


def _check_view(light: Light, view: int | None) -> None:
    views = RayDomain(light.camera_shape).views
    if view is not None and not 0 <= view < views:
        raise InputError(f"view {view}: the camera's rays have views 0 to {views - 1}")


def _shown(
    light: Light, images: Iterable[Float], scale: Scale, view: int | None
) -> Iterator[Float]:
    """Yield the pictures to show of images (*camera_shape, C)."""
    domain = RayDomain(light.camera_shape)
    for image in images:
        stack = image.reshape(*domain.stack_shape, light.channels)
        shown = stack.reshape(*domain.picture_shape, -1) if view is None else stack[view]
        yield scale.apply(shown)


class Lighting(Protocol):
    """A pattern that any process can make or read."""

    @property
    def name(self) -> str:
        """What its picture is called."""

    def weights(self) -> Float:
        """Return the weights, as `Light.relight` takes them."""


def open_light(path: Path, level: int | None, dual: bool) -> Light:
    """Open a transport, or its dual, as known after a level."""
    transport = open_transport(path)
    if level is not None:
        transport = transport.truncate(level)
    return transport.T if dual else transport


@dataclass(frozen=True, eq=False)
class _RelitFiles:
    """Relights patterns and writes their pictures; any thread or process may."""

    path: Path
    level: int | None
    dual: bool
    lights: tuple[Lighting, ...]
    folder: Path
    form: str | None
    scale: Scale
    white: float | None
    view: int | None

    def __call__(self, first: int, last: int) -> list[float]:
        """Relight some patterns; return what would be white in each, where none is written."""
        lights = self.lights[first:last]
        bright = []
        for lit, image in zip(
            lights, self._relit([each.weights() for each in lights]), strict=True
        ):
            picture = next(_shown(self.light, [image], self.scale, self.view))
            if self.form is None:
                bright.append(float(np.percentile(picture, _WHITE)))
                continue
            path = self.folder / f"{lit.name}.{self.form}"
            failing = storage_errors(path, "writing", picture.nbytes, resumes=False)
            with failing, whole_file(path) as partial:
                write_image(partial, picture, self.white, {"rfpipe:pattern": lit.name})
        return bright

    def _relit(self, patterns: list[Float]) -> Iterator[Float]:
        """Relight white and coloured patterns, those alike together."""
        start = 0
        while start < len(patterns):
            stop = start + 1
            while stop < len(patterns) and patterns[stop].shape == patterns[start].shape:
                stop += 1
            with _relighting:
                images = self.light.relight_batch(np.stack(patterns[start:stop]))
            yield from images
            start = stop

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the transport: whoever does the work opens it."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def light(self) -> Light:
        return open_light(self.path, self.level, self.dual)


def relit_files(
    path: Path,
    lights: Sequence[Lighting],
    folder: Path,
    *,
    form: str = "exr",
    scale: Scale | None = None,
    white: float | None = None,
    view: int | None = None,
    level: int | None = None,
    dual: bool = False,
    resources: Resources | None = None,
) -> float | None:
    """Relight with many patterns and write a picture each, named as its pattern.

    The files have the same bytes wherever the work is done.

    Parameters
    ----------
    path : path
        Of a stored transport.
    lights : sequence of Lighting
    folder : path
        Made where it is missing.
    form : {"exr", "png"}
    scale : Scale, optional
    white : float, optional
        Radiance shown as white in a .png; by default all but the brightest thousandth of the
        samples of the brightest picture are shown as they are, for which all is relit twice.
    view : int, optional
        The one of several views to show.
    level : int, optional
        Use the transport as known after this level only.
    dual : bool
        Light from the camera, see from the projector.
    resources : Resources, optional

    Returns
    -------
    float or None
        Radiance shown as white; None in EXR files, which have none.

    Raises
    ------
    InputError
        As `relit_pictures`, and where two patterns have one name.
    StoreError
        If the transport can't be read or a file can't be written.
    """
    resources = resources or Resources()
    names = [lit.name for lit in lights]
    twice = next((name for index, name in enumerate(names) if name in names[:index]), None)
    if twice is not None:
        raise InputError(f"two patterns are named {twice}; rename one, or export them apart")

    def work(form: str | None, white: float | None, scale: Scale) -> _RelitFiles:
        return _RelitFiles(
            path.absolute(), level, dual, tuple(lights), folder.absolute(), form, scale, white,
            view,
        )  # fmt: skip

    opened = open_light(path, level, dual)
    _check_view(opened, view)
    rays = max(prod(opened.camera_shape), prod(opened.projector_shape))
    in_hand = _AT_A_TIME * _COPIES * rays * opened.channels * np.dtype(np.float32).itemsize
    runs = [(i, min(i + _AT_A_TIME, len(lights))) for i in range(0, len(lights), _AT_A_TIME)]
    folder.mkdir(parents=True, exist_ok=True)
    with resources.workers(in_hand, folder) as workers:

        def done(what: str, relighting: _RelitFiles) -> list[float]:
            found: list[float] = []
            with Progress(what, len(lights), unit="picture", quick=True) as progress:
                results = workers.results(relighting, runs)
                for (first, last), bright in zip(runs, results, strict=True):
                    found += bright
                    progress.advance(last - first)
            return found

        if form == "png" and white is None:
            white = max(done("white", work(None, None, Scale())), default=0.0)
        done(str(folder), work(form, white or None, scale or Scale()))
    return white


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
    """Write the movie of a light path.

    Parameters
    ----------
    light : Light
    path : path
        Ends in ``.mp4`` or ``.webm``.
    lights : LightPath
        Of the projector's rays.
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

    Returns
    -------
    float
        Radiance shown as white.

    Raises
    ------
    InputError
        As `relit_pictures` and `write_movie`.
    StoreError
        As `write_movie`.
    """
    from tqdm import tqdm

    def relit(scale: Scale | None, what: str) -> Iterator[Float]:
        pictures = relit_pictures(light, _each(lights), scale, view)
        return iter(
            tqdm(pictures, what, lights.count, unit="picture", disable=None if progress else True)
        )

    if white is None:
        brightest = (float(np.percentile(image, _WHITE)) for image in relit(None, "white"))
        white = max(brightest) or 1.0
    if not 0 < white < float("inf"):
        raise InputError(f"white is {white}; expected a radiance above 0")
    shown = (_eight_bits(image, white) for image in relit(scale, str(path)))
    write_movie(path, shown, fps)
    return white


def _each(lights: LightPath) -> Iterator[Float]:
    for index in range(lights.count):
        yield lights.batch(index, index + 1)[0]


def _eight_bits(image: Float, white: float) -> NDArray[np.uint8]:
    shown: NDArray[np.uint8] = np.rint(255 * srgb(image, white)).astype(np.uint8)
    return shown
