"""What a step of a calibration has at hand: the devices, and the findings of earlier steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.verdicts import Findings
from rfpipe.config import CalibrationConfig
from rfpipe.errors import CaptureError, RfpipeError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.devices import STEPS as WEIGHTS
from rfpipe.rigs.devices import Camera, Projector, bracket_of, code_table, shown_bracket

Float = NDArray[np.float32]
Double = NDArray[np.float64]


Progress = Callable[[str, int], AbstractContextManager[Any]]
"""Makes what counts pictures of a title, such as `rfpipe.jobs.job.Progress`."""


class DeviceError(Exception):
    """Carries the error of a device past those who take errors for findings."""


@contextmanager
def driving() -> Iterator[None]:
    """Tell errors of devices from those of what is measured."""
    try:
        yield
    except RfpipeError as error:
        raise DeviceError(error) from error


def camera_model(camera: Camera) -> CameraModel:
    """Return the camera's own model; CaptureError when it has none that could be calibrated."""
    if not isinstance(camera.sensor, CameraModel):
        raise CaptureError(
            f"a camera with a {type(camera.sensor).__name__} has no noise to calibrate; expected "
            "counts of a CameraModel"
        )
    return camera.sensor


def camera_numbers(found: Mapping[str, Findings]) -> dict[str, Any]:
    """Return the parameters of `CameraModel` that were measured."""
    names = {field.name for field in fields(CameraModel)}
    facts = (fact for one in found.values() for fact in one.facts.items())
    numbers = {name: value for name, value in facts if name in names}
    if "black_level_counts" in numbers:
        numbers["black_level_counts"] = max(0, round(numbers["black_level_counts"]))
    return numbers


@dataclass(frozen=True)
class Bench:
    """What a step has at hand.

    Attributes
    ----------
    projector, camera, settings
        The projector shows codes: weight times 255, without a response of its own.
    rays : (int, int) or None
        Ray domain, or that of each view; None: each projector pixel is a ray.
    found : mapping of str to Findings
        Of the steps that this one needs.
    progress : callable
        ``progress(pictures)`` makes what counts so many pictures.
    """

    projector: Projector
    camera: Camera
    settings: CalibrationConfig
    rays: tuple[int, int] | None
    found: Mapping[str, Findings]
    progress: Callable[[int], AbstractContextManager[Any]]

    @property
    def model(self) -> CameraModel:
        """The camera with the numbers measured so far."""
        return replace(camera_model(self.camera), **camera_numbers(self.found))

    def flat(self, weight: float) -> Float:
        """Return a picture of one weight everywhere."""
        return np.broadcast_to(np.float32(weight), self.projector.shape)

    def take(
        self,
        pictures: Sequence[Any],
        *,
        linear: bool = False,
        drawn: Callable[[Any], Float] = np.asarray,
        wait: float = 0.0,
    ) -> Iterator[NDArray[Any]]:
        """Show pictures one by one; yield the bracket of each, shape (E, Hc, Wc[, C]).

        Parameters
        ----------
        pictures : sequence of ndarray of float32, shape (H, W)
            Weights in [0, 1]: codes, or light. Or whatever `drawn` makes such a picture of.
        linear : bool
            Whether the weights are light, looked up in the projector's measured response.
        drawn : callable, optional
        wait : float
            Seconds between picture and bracket, beyond those that the projector waits itself.
        """
        codes = code_table(self.found["light"]["light"]) if linear else None
        with self.progress(len(pictures)) as counts:
            for index, picture in enumerate(pictures):
                shown = drawn(picture)
                if codes is not None:
                    at = np.rint(np.clip(shown, 0, 1) * WEIGHTS).astype(np.int64)
                    shown = (codes[at] / np.float32(255)).astype(np.float32)
                with driving():
                    if wait:
                        self.projector.show(shown)
                        time.sleep(wait)
                    frames = bracket_of(self.projector, self.camera, shown, f"picture {index}")
                if counts is not None:
                    counts.advance(1)
                yield frames

    def take_primaries(self) -> NDArray[Any] | None:
        """Show red, green and blue everywhere; return the brackets, shape (3, E, Hc, Wc).

        None where the projector shows no colours.
        """
        show_colour = getattr(self.projector, "show_colour", None)
        if show_colour is None:
            return None
        brackets = []
        with self.progress(3) as counts, driving():
            for index, name in enumerate(("red", "green", "blue")):
                picture = np.zeros((*self.projector.shape, 3), np.float32)
                picture[..., index] = 1
                show = partial(show_colour, picture)
                brackets.append(shown_bracket(show, self.projector, self.camera, name))
                if counts is not None:
                    counts.advance(1)
        return np.stack(brackets)

    def radiance(
        self, pictures: Sequence[Float], *, linear: bool = False
    ) -> Iterator[tuple[Double, Double]]:
        """Show pictures; yield merged radiance and variance of each, (Hc, Wc).

        Channels are added up: the light is white.
        """
        dark = self.found["dark"]
        merge = self.model.merging(dark["black"], dark["frames"])
        for frames in self.take(pictures, linear=linear):
            merged = merge(frames[None])
            yield (
                merged.radiance[0].sum(axis=-1, dtype=np.float64),
                merged.variance[0].sum(axis=-1, dtype=np.float64),
            )
