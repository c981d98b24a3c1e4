"""Which point of the projector each camera pixel looks at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Verdict, take
from rfpipe.calibration.codes import AxisCode
from rfpipe.photometry import CameraModel, MergeOptions
from rfpipe.rigs.devices import Camera, Projector

__all__ = [
    "Correspondence",
    "correspondence_findings",
    "measure_correspondence",
    "structured_light",
    "take_radiance",
]

Float = NDArray[np.float32]
Double = NDArray[np.float64]

LEAST_PIXELS = 100
WANTED = 0.1
"""Standard error in projector pixels up to which single camera pixels are sharp."""


_MEASURED = ("x", "y", "error", "modulation", "contrast")


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Where on the projector each camera pixel looks; pixels from its upper left corner.

    Attributes
    ----------
    x, y : ndarray of float64, shape (Hc, Wc)
        To the right and downwards; a projector pixel's middle lies at halves. Means nothing where
        not valid.
    error : ndarray of float64, shape (Hc, Wc)
        Standard error by the noise, the larger of both axes.
    modulation : ndarray of float64, shape (Hc, Wc)
        The sinusoids' amplitude over its noise, the smaller of both axes.
    contrast : ndarray of float64, shape (2, Hc, Wc)
        Of stripes of one period over those of two, along x and along y; see `Decoded`.
    valid : ndarray of bool, shape (Hc, Wc)
    projector_shape : (int, int)
    period : int
        Of the stripes, in projector pixels.
    """

    x: Double
    y: Double
    error: Double
    modulation: Double
    contrast: Double
    valid: NDArray[np.bool_]
    projector_shape: tuple[int, int]
    period: int

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return what `from_arrays` needs, to be stored."""
        return {
            **{name: getattr(self, name).astype(np.float32) for name in _MEASURED},
            "valid": self.valid,
            "period": np.array(self.period, np.int32),
            "projector_shape": np.array(self.projector_shape, np.int32),
        }

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]]) -> Correspondence:
        """Return the correspondence whose `arrays` these are."""
        height, width = map(int, arrays["projector_shape"])
        measured = {name: arrays[name].astype(np.float64) for name in _MEASURED}
        return cls(
            **measured,
            valid=arrays["valid"],
            projector_shape=(height, width),
            period=int(arrays["period"]),
        )


def structured_light(shape: tuple[int, int], period: int, steps: int) -> Iterator[Float]:
    """Yield the pictures: those that tell x, then those that tell y.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the projector in pixels.
    period, steps : int
        See `AxisCode`.
    """
    for axis, extent in ((1, shape[1]), (0, shape[0])):
        for line in AxisCode(extent, period, steps).lines():
            yield np.broadcast_to(np.expand_dims(line, 1 - axis), shape).astype(np.float32)


def take_radiance(
    projector: Projector,
    camera: Camera,
    model: CameraModel,
    black: NDArray[Any],
    black_count: int,
    pictures: Iterable[Float],
) -> Iterator[tuple[Float, Float]]:
    """Show pictures; yield merged radiance and variance of each, (Hc, Wc, C)."""
    merge = model.merging(black, MergeOptions(black_count))
    for frames in take(projector, camera, pictures):
        merged = merge(frames[None])
        yield merged.radiance[0], merged.variance[0]


def measure_correspondence(
    images: Iterable[tuple[Float, Float]], shape: tuple[int, int], period: int, steps: int
) -> Correspondence:
    """Decode structured light.

    Parameters
    ----------
    images : iterable of (radiance, variance), each float32 (Hc, Wc, C)
        Under the pictures of `structured_light`.
    shape : (int, int)
        Of the projector.
    period, steps : int
        As the pictures were made with.
    """
    remaining = iter(images)
    decoded = []
    for extent in (shape[1], shape[0]):
        code = AxisCode(extent, period, steps)
        # channels together: the light is white
        grey = [
            (radiance.sum(axis=-1, dtype=np.float64), variance.sum(axis=-1, dtype=np.float64))
            for _, (radiance, variance) in zip(range(code.count), remaining, strict=False)
        ]
        decoded.append(code.decode(*(np.stack(part) for part in zip(*grey, strict=True))))
    x, y = decoded
    return Correspondence(
        x.coordinate,
        y.coordinate,
        np.maximum(x.error, y.error),
        np.minimum(x.modulation, y.modulation),
        np.stack([x.contrast, y.contrast]),
        x.valid & y.valid,
        shape,
        period,
    )


def correspondence_findings(correspondence: Correspondence) -> Findings:
    """Return the step's findings, with a verdict on how many pixels are valid, and how sharp."""
    valid = correspondence.valid
    share = float(valid.mean())
    error = float(np.median(correspondence.error[valid])) if valid.any() else None
    facts = {
        "valid_pixels": int(valid.sum()),
        "valid_share": share,
        "median_error_pixels": error,
        "period_pixels": correspondence.period,
        "projector_shape": list(correspondence.projector_shape),
    }
    if valid.sum() < LEAST_PIXELS or error is None:
        verdict = Verdict(
            "poor",
            f"Only {int(valid.sum())} camera pixels see the projector's stripes. Check focus, that "
            "the camera sees what the projector lights, and the exposures; or make the stripes "
            f"wider than {correspondence.period} pixels a period.",
        )
    elif error > WANTED:
        verdict = Verdict(
            "poor",
            f"{share:.0%} of the camera's pixels are decoded, but their noise is {error:.2f} "
            f"projector pixels, above {WANTED}: use longer exposures.",
        )
    else:
        verdict = Verdict(
            "good",
            f"{share:.0%} of the camera's pixels are decoded, with a noise of {error:.3f} "
            "projector pixels.",
        )
    return Findings(verdict, facts, correspondence.arrays())
