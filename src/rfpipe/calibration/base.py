"""What the steps of a calibration share: their findings, verdicts, and driving the devices."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.devices import Camera, Projector, bracket_of

__all__ = ["Findings", "Measured", "Standing", "Verdict", "camera_model", "take", "uniform"]

Float = NDArray[np.float32]
Standing = Literal["good", "poor", "unknown", "failed"]


@dataclass(frozen=True)
class Verdict:
    """Whether what a step found is good enough.

    Attributes
    ----------
    standing : {"good", "poor", "unknown", "failed"}
        unknown: the measurement can't tell; the text says what would. failed: there is none.
    text : str
        Why, with the numbers behind it, and what to do.
    """

    standing: Standing
    text: str

    @classmethod
    def of(cls, faults: list[str], otherwise: str) -> Verdict:
        """Return a poor verdict that names the faults, or a good one."""
        return cls("poor", " ".join(faults)) if faults else cls("good", otherwise)


@dataclass(frozen=True)
class Findings:
    """What a step found.

    Attributes
    ----------
    verdict : Verdict
    facts : dict
        Plain data: numbers with their standard errors.
    arrays : dict of str to ndarray
        What the rig, later steps and the report's pictures need.
    """

    verdict: Verdict
    facts: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, NDArray[Any]] = field(default_factory=dict)


class Measured:
    """What a step measured, a dataclass: its arrays are stored, its other fields are facts."""

    def findings(self, verdict: Verdict, **facts: Any) -> Findings:
        """Return the step's findings, with facts beside its own."""
        found = {each.name: getattr(self, each.name) for each in fields(self)}  # type: ignore[arg-type]
        arrays = {name: value for name, value in found.items() if isinstance(value, np.ndarray)}
        own = {name: value for name, value in found.items() if name not in arrays}
        return Findings(verdict, own | facts, arrays)

    @classmethod
    def of(cls, findings: Findings) -> Self:
        """Return what was measured, from its findings."""
        found = findings.facts | findings.arrays
        return cls(**{each.name: found[each.name] for each in fields(cls)})  # type: ignore[arg-type]


def uniform(projector: Projector, weight: float) -> Float:
    """Return a picture of one weight everywhere."""
    return np.full(projector.shape, weight, np.float32)


def take(projector: Projector, camera: Camera, pictures: Iterable[Float]) -> Iterator[NDArray[Any]]:
    """Show pictures one by one; yield the bracket of each, shape (E, Hc, Wc[, C]).

    Raises
    ------
    CaptureError
        When a device fails, or the camera returns what is no bracket of its own.
    """
    for index, picture in enumerate(pictures):
        yield bracket_of(projector, camera, picture, f"calibration picture {index}")


def camera_model(camera: Camera) -> CameraModel:
    """Return the camera's own model.

    Raises
    ------
    CaptureError
        When the camera has no noise model that could be calibrated.
    """
    sensor = camera.sensor
    if not isinstance(sensor, CameraModel):
        raise CaptureError(
            f"a camera with a {type(sensor).__name__} has no noise to calibrate; expected counts "
            "of a CameraModel"
        )
    return sensor
