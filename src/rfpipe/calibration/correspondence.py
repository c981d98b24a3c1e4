"""Which point of the projector each camera pixel looks at."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Measured, Verdict, take
from rfpipe.calibration.codes import AxisCode
from rfpipe.calibration.dark import Dark
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
LEAST_DECODED = 0.7
"""Share of the lit pixels to be decoded; at the outline, and on what is black, none are."""

WANTED = 0.1
"""Standard error in projector pixels up to which single camera pixels are sharp."""


@dataclass(frozen=True, eq=False)
class Correspondence(Measured):
    """Where on the projector each camera pixel looks; pixels from its upper left corner.

    Attributes
    ----------
    x, y : ndarray of float32, shape (Hc, Wc)
        To the right and downwards; a projector pixel's middle lies at halves. Means nothing where
        not valid.
    error : ndarray of float32, shape (Hc, Wc)
        Standard error by the noise, the larger of both axes.
    modulation : ndarray of float32, shape (Hc, Wc)
        The sinusoids' amplitude over its noise, the smaller of both axes.
    contrast : ndarray of float32, shape (2, Hc, Wc)
        Of stripes of one period over those of two, along x and along y; see `Decoded`.
    valid : ndarray of bool, shape (Hc, Wc)
    projector_shape : (int, int)
    period_pixels : int
        Of the stripes, in projector pixels.
    """

    x: Float
    y: Float
    error: Float
    modulation: Float
    contrast: Float
    valid: NDArray[np.bool_]
    projector_shape: tuple[int, int]
    period_pixels: int

    @property
    def points(self) -> Double:
        """Where the pixels look, as (x, y), float64 (Hc, Wc, 2)."""
        return np.stack([self.x, self.y], axis=-1, dtype=np.float64)


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
    dark: Dark,
    pictures: Iterable[Float],
) -> Iterator[tuple[Float, Float]]:
    """Show pictures; yield merged radiance and variance of each, (Hc, Wc, C)."""
    merge = model.merging(dark.black, MergeOptions(dark.frames))
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
    error, modulation = np.maximum(x.error, y.error), np.minimum(x.modulation, y.modulation)
    return Correspondence(
        x.coordinate.astype(np.float32),
        y.coordinate.astype(np.float32),
        error.astype(np.float32),
        modulation.astype(np.float32),
        np.stack([x.contrast, y.contrast], dtype=np.float32, casting="same_kind"),
        x.valid & y.valid,
        shape,
        period,
    )


def correspondence_findings(
    correspondence: Correspondence, lit: NDArray[np.bool_] | None = None
) -> Findings:
    """Return the step's findings, with a verdict on how many pixels are valid, and how sharp.

    Parameters
    ----------
    correspondence : Correspondence
    lit : ndarray of bool, shape (Hc, Wc), optional
        Where the projector's own light falls; most of it should be decoded.
    """
    valid = correspondence.valid
    of_lit = 1.0 if lit is None or not lit.any() else float(valid[lit].mean())
    share = float(valid.mean())
    error = float(np.median(correspondence.error[valid])) if valid.any() else None
    if valid.sum() < LEAST_PIXELS or error is None:
        verdict = Verdict(
            "poor",
            f"Only {int(valid.sum())} camera pixels see the projector's stripes. Check focus, that "
            "the camera sees what the projector lights, and the exposures; or make the stripes "
            f"wider than {correspondence.period_pixels} pixels a period.",
        )
    elif of_lit < LEAST_DECODED:
        verdict = Verdict(
            "poor",
            f"Only {of_lit:.0%} of the camera's pixels that the projector lights are decoded; "
            f"{LEAST_DECODED:.0%} are wanted. They are saturated, too dark or out of focus: mend "
            "exposures and focus first.",
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
    return correspondence.findings(
        verdict,
        valid_pixels=int(valid.sum()),
        valid_share=share,
        decoded_of_lit=of_lit,
        median_error_pixels=error,
    )
