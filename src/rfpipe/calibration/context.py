"""Input of a calibration step: devices, settings and the findings of earlier steps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float
from rfpipe.calibration.verdicts import Findings
from rfpipe.config import CalibrationConfig
from rfpipe.errors import CaptureError, RfpipeError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.devices import (
    WEIGHT_STEPS,
    Camera,
    Projector,
    bracket_of,
    code_table,
    shown_bracket,
)

ProgressBar = Callable[[str, int], AbstractContextManager[Any]]
"""Function of a title and a number of pictures, returns a progress bar as a context manager."""


class DeviceError(Exception):
    """Error of a device, which ends the calibration; other errors are findings of a step."""


@contextmanager
def device_errors() -> Iterator[None]:
    """Raise errors of devices as DeviceError."""
    try:
        yield
    except RfpipeError as error:
        raise DeviceError(error) from error


def camera_model(camera: Camera) -> CameraModel:
    """Model of a camera that counts; CaptureError for another sensor."""
    if not isinstance(camera.sensor, CameraModel):
        raise CaptureError(
            f"the camera's sensor is a {type(camera.sensor).__name__}; a calibration needs one "
            "that counts, a CameraModel"
        )
    return camera.sensor


def camera_numbers(findings: Mapping[str, Findings]) -> dict[str, Any]:
    """Collect the measured parameters of `CameraModel` from the findings of all steps."""
    names = {field.name for field in fields(CameraModel)}
    facts = (fact for of_step in findings.values() for fact in of_step.facts.items())
    numbers = {name: value for name, value in facts if name in names}
    if "black_level_counts" in numbers:
        numbers["black_level_counts"] = max(0, round(numbers["black_level_counts"]))
    return numbers


def _looked_up(light: Float, codes: NDArray[np.uint8]) -> Float:
    """Codes, as fractions of 255, of light in [0, 1], by a table over `WEIGHT_STEPS` + 1 levels."""
    index = np.rint(np.clip(light, 0, 1) * WEIGHT_STEPS).astype(np.int64)
    return np.asarray(codes[index] / np.float32(255), np.float32)


@dataclass(frozen=True)
class StepContext:
    """Input of a calibration step.

    Attributes
    ----------
    projector : Projector
        Shows codes: weight times 255, no response is applied.
    camera : Camera
    settings : CalibrationConfig
    rays : (int, int) or None
        Shape of the ray domain, or of each view's; None: each projector pixel is a ray.
    findings : mapping of str to Findings
        Findings of the steps on which this one depends.
    progress : callable
        ``progress(count)`` returns a progress bar of `count` pictures as a context manager.
    """

    projector: Projector
    camera: Camera
    settings: CalibrationConfig
    rays: tuple[int, int] | None
    findings: Mapping[str, Findings]
    progress: Callable[[int], AbstractContextManager[Any]]

    @property
    def model(self) -> CameraModel:
        """Camera model with the parameters measured so far."""
        return replace(camera_model(self.camera), **camera_numbers(self.findings))

    def flat_picture(self, weight: float) -> Float:
        """Picture with the same weight everywhere, float32 (H, W)."""
        return np.broadcast_to(np.float32(weight), self.projector.shape)

    def brackets(
        self, pictures: Iterable[Float], count: int, *, linear: bool = False, wait: float = 0.0
    ) -> Iterator[NDArray[Any]]:
        """Show pictures one by one, and yield the bracket of each, shape (E, Hc, Wc[, C]).

        Parameters
        ----------
        pictures : iterable of ndarray of float32, shape (H, W)
            Weights in [0, 1]: codes, or light if `linear`.
        count : int
            Number of pictures.
        linear : bool
            Whether the weights are light. The measured response of the projector turns them into
            codes.
        wait : float
            Seconds between display and exposure, in addition to the projector's own wait.
        """
        codes = code_table(self.findings["light"]["light"]) if linear else None
        with self.progress(count) as bar:
            for index, picture in enumerate(pictures):
                displayed = picture if codes is None else _looked_up(picture, codes)
                frames = self._bracket(displayed, f"picture {index}", wait)
                if bar is not None:
                    bar.advance(1)
                yield frames

    def _bracket(self, picture: Float, name: str, wait: float) -> NDArray[Any]:
        """Show a picture, wait, and capture its bracket."""
        with device_errors():
            if wait:
                self.projector.show(picture)
                time.sleep(wait)
            return bracket_of(self.projector, self.camera, picture, name)

    def primary_brackets(self) -> NDArray[Any] | None:
        """Show red, green and blue everywhere, and return the brackets, shape (3, E, Hc, Wc).

        None where the projector can't show colours.
        """
        show_colour = getattr(self.projector, "show_colour", None)
        if show_colour is None:
            return None
        brackets = []
        with self.progress(3) as bar, device_errors():
            for index, name in enumerate(("red", "green", "blue")):
                picture = np.zeros((*self.projector.shape, 3), np.float32)
                picture[..., index] = 1
                show = partial(show_colour, picture)
                brackets.append(shown_bracket(show, self.projector, self.camera, name))
                if bar is not None:
                    bar.advance(1)
        return np.stack(brackets)

    def radiance(
        self, pictures: Sequence[Float], *, linear: bool = False
    ) -> Iterator[tuple[Double, Double]]:
        """Show pictures, and yield merged radiance and variance of each, float64 (Hc, Wc).

        Channels are summed, since the light is white.
        """
        dark = self.findings["dark"]
        merge = self.model.bracket_merge(dark["black"], dark["frames"])
        for frames in self.brackets(pictures, len(pictures), linear=linear):
            merged = merge(frames[None])
            yield (
                merged.radiance[0].sum(axis=-1, dtype=np.float64),
                merged.variance[0].sum(axis=-1, dtype=np.float64),
            )
