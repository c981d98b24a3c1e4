"""The thread that shows pictures and keeps the last look at what the camera sees of them."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import camera_model
from rfpipe.calibration.sight import (
    SATURATED,
    measure_sight,
    sight_findings,
    sight_pictures,
)
from rfpipe.calibration.sight_picture import sight_picture
from rfpipe.errors import RfpipeError
from rfpipe.rigs.devices import Camera, Projector, bracket_of

__all__ = ["MODES", "Look", "Watch"]

Mode = Literal["measure", "white", "stripes", "off"]

MODES: tuple[Mode, ...] = ("measure", "white", "stripes", "off")
"""What the projector shows: all that is measured from, in turn; or one picture, held."""

AGAIN_SECONDS = 2.0
"""Wait after a device failed, before it is tried again."""


@dataclass(frozen=True)
class Look:
    """What was seen last.

    Attributes
    ----------
    number : int
        Counts looks from 1; 0: none yet.
    picture : bytes
        A PNG file; empty where there is none.
    told : dict
        Plain data for the page: verdict, numbers and the proposed bracket.
    """

    number: int = 0
    picture: bytes = b""
    told: dict[str, Any] = field(default_factory=dict)


class Watch:
    """Shows and looks until it is closed; a device that fails is told of, and tried again.

    Parameters
    ----------
    devices : callable
        Returns projector and camera; is called in the thread that uses them.
    period : int
        Of the stripes in projector pixels.
    """

    def __init__(self, devices: Callable[[], tuple[Projector, Camera]], period: int) -> None:
        self._devices = devices
        self._period = period
        self._mode: Mode = "measure"
        self._look = Look()
        self._error: str | None = None
        self._stopping = threading.Event()
        self._turned = threading.Event()
        self._opened = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="aim", daemon=True)

    def start(self) -> None:
        """Open the devices and begin.

        Raises
        ------
        RfpipeError
            When a device can't be opened.
        """
        self._thread.start()
        self._opened.wait()
        if self._failure is not None:
            raise self._failure

    @property
    def look(self) -> Look:
        """The last look."""
        return self._look

    @property
    def state(self) -> dict[str, Any]:
        """Plain data: what is shown, what was seen last, and what is wrong with the devices."""
        look = self._look
        return {"number": look.number, "mode": self._mode, "error": self._error, **look.told}

    def turn(self, mode: Mode) -> None:
        """Have another picture shown."""
        self._mode = mode
        self._turned.set()

    def close(self) -> None:
        """Give the devices back, after the exposure in hand."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        try:
            projector, camera = self._devices()
        except BaseException as error:
            self._failure = error
            return
        finally:
            self._opened.set()
        try:
            while not self._stopping.is_set():
                self._turned.clear()
                try:
                    self._look_once(projector, camera)
                    self._error = None
                except RfpipeError as error:
                    self._error = str(error)
                    self._stopping.wait(AGAIN_SECONDS)
        finally:
            camera.close()
            projector.close()

    def _look_once(self, projector: Projector, camera: Camera) -> None:
        """Take what the mode asks for; leave it where the mode changes meanwhile."""
        mode = self._mode
        taken = []
        for index, shown in enumerate(_pictures(mode, projector.shape, self._period)):
            taken.append(bracket_of(projector, camera, shown, f"picture {index}"))
            if self._stopping.is_set() or self._turned.is_set():
                return
        model = camera_model(camera)
        times, white_level = model.exposures, model.white_level
        if mode == "measure":
            sight = measure_sight(taken, times, white_level, self._period)
            found = sight_findings(sight, times, white_level)
            picture = sight_picture(sight.white, sight.saturated, sight.dark, sight.lit)
            proposal = [f"{one:g}" for one in found.facts["proposed_exposures_s"]]
            told = {
                "standing": found.verdict.standing,
                "verdict": found.verdict.text,
                "saturated": found.facts["saturated_share"],
                "dark": float(sight.dark.sum() / max(sight.lit.sum(), 1)),
                "lit": found.facts["lit_share"],
                "focus": found.facts["focus_contrast"],
                "exposures": list(times),
                "proposal": f"sensor:\n  exposures: [{', '.join(proposal)}]",
            }
        else:
            picture, told = _held(taken[0], times, white_level)
            told = {**self._look.told, **told}
        self._look = Look(self._look.number + 1, _png(picture), told)


def _pictures(mode: Mode, shape: tuple[int, int], period: int) -> Iterator[NDArray[np.float32]]:
    """Yield what a mode shows."""
    if mode == "measure":
        yield from sight_pictures(shape, period)
    elif mode == "stripes":
        y, x = np.mgrid[: shape[0], : shape[1]]
        yield ((x % period < period / 2) ^ (y % period < period / 2)).astype(np.float32)
    else:
        yield np.full(shape, float(mode == "white"), np.float32)


def _held(
    bracket: NDArray[np.uint16], exposures: Sequence[float], white_level: int
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """Return the picture of a bracket: each pixel's longest exposure that isn't saturated."""
    frames = bracket if bracket.ndim == 3 else bracket.max(axis=-1)
    full = frames >= SATURATED * white_level
    best = np.maximum((~full).sum(axis=0) - 1, 0)[None]
    # the darkest of a frame are about as dark as without light
    light = frames - np.percentile(frames, 1, axis=(1, 2), keepdims=True)
    rates = light / np.reshape(exposures, (-1, 1, 1))
    shortest: NDArray[np.bool_] = full[0]
    picture = sight_picture(
        np.take_along_axis(rates, best, 0)[0], shortest, np.zeros_like(shortest)
    )
    return picture, {"saturated_now": float(shortest.mean())}


def _png(picture: NDArray[np.float64]) -> bytes:
    from matplotlib.image import imsave

    buffer = io.BytesIO()
    imsave(buffer, picture, format="png", metadata={"Software": ""})
    return buffer.getvalue()
