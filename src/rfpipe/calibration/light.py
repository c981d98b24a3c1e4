"""The projector's response: how much light each code gives."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.calibration.base import Findings, Float, Measured, Verdict
from rfpipe.errors import CaptureError
from rfpipe.rigs.devices import Projector, undisturbed
from rfpipe.rigs.window import STEPS, code_table

__all__ = ["LightCurve", "LinearProjector", "codes_of", "light_findings", "measure_light"]

Double = NDArray[np.float64]

CODES = 256
BRIGHT = 0.5
"""Of the 90th percentile of the lit pixels' light: darker ones add more noise than knowledge."""

SURE = 4.0
LEAST_OVER_NOISE = 30.0
"""Below, the choice of lit pixels by a noisy picture makes later pictures seem darker."""

SIGNIFICANCE = 10.0
"""Deviations of noise from which on a pixel is lit."""


@dataclass(frozen=True, eq=False)
class LightCurve(Measured):
    """Light of the projector's codes, as a fraction of that of the last one.

    Attributes
    ----------
    codes : ndarray of int64, shape (n,)
        The codes shown.
    measured, error : ndarray of float64, shape (n,)
        Median over lit camera pixels; its standard error.
    light : ndarray of float64, shape (256,)
        The monotone curve through them, from 0 to 1.
    drift : float
        Change of the full light between the first and the last picture, a fraction.
    pixels : int
        Camera pixels measured at.
    over_noise : float
        Their light under full light over its noise, median.
    """

    codes: NDArray[np.int64]
    measured: Double
    error: Double
    light: Double
    drift: float
    pixels: int
    over_noise: float


class LinearProjector:
    """A projector whose weights are light, by looking up codes in its measured response.

    Parameters
    ----------
    projector : Projector
        Shows codes: weight times 255.
    light : ndarray of float64, shape (256,)
    """

    def __init__(self, projector: Projector, light: Double) -> None:
        self._projector = projector
        self._table = (code_table(light) / np.float32(CODES - 1)).astype(np.float32)
        self.shape = projector.shape

    def show(self, picture: Float) -> None:
        """Show a picture in linear light; see `rfpipe.rigs.devices.Projector.show`."""
        weights = np.rint(np.clip(picture, 0, 1) * STEPS).astype(np.int64)
        self._projector.show(self._table[weights])

    def undisturbed(self) -> bool:
        """Whether the last picture stood; see `rfpipe.rigs.devices.Projector`."""
        return undisturbed(self._projector)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        return self._projector.describe()

    def close(self) -> None:
        """Give the display back."""
        self._projector.close()


def codes_of(count: int) -> NDArray[np.int64]:
    """Return the codes to show: full light first and last, and between them from dark to bright."""
    steps = np.unique(np.rint(np.linspace(0, CODES - 1, count)).astype(np.int64))
    return np.concatenate([[CODES - 1], steps])


def measure_light(
    images: Iterable[tuple[Float, Float]], codes: Sequence[int] | NDArray[np.int64]
) -> LightCurve:
    """Measure the light of codes.

    Parameters
    ----------
    images : iterable of (radiance, variance), each float32 (Hc, Wc, C)
        Under flat pictures of the codes, black subtracted.
    codes : sequence of int
        Theirs; the first and the last are 255.

    Raises
    ------
    CaptureError
        When no pixel is lit by code 255.
    """
    from scipy.interpolate import PchipInterpolator
    from scipy.optimize import isotonic_regression

    codes = np.asarray(codes)
    remaining = iter(images)
    full, variance = (part.sum(axis=-1, dtype=np.float64) for part in next(remaining))
    lit = full > SIGNIFICANCE * np.sqrt(variance)
    if not lit.any():
        raise CaptureError(
            "no camera pixel is lit by the projector's full light; check lamp, lens cap and "
            "exposures"
        )
    lit &= full > BRIGHT * np.percentile(full[lit], 90)
    measured, error = [], []
    last = 1.0
    for radiance, _ in remaining:
        ratio = radiance.sum(axis=-1, dtype=np.float64)[lit] / full[lit]
        measured.append(float(np.median(ratio)))
        # the median's standard error is 1.2533 times the mean's
        error.append(1.2533 * float(ratio.std()) / np.sqrt(ratio.size))
        last = measured[-1]
    shown = codes[1:]
    # full light at the end, rather than at the beginning, is that of the curve's own time
    relative = np.array(measured) / last
    spread = np.maximum(error, 1e-6)
    monotone = isotonic_regression(relative, weights=spread**-2.0).x
    monotone = (monotone - monotone[0]) / (monotone[-1] - monotone[0])
    light = PchipInterpolator(shown, monotone)(np.arange(CODES))
    light = np.maximum.accumulate(np.clip(light, 0, 1))
    over_noise = float(np.median(full[lit] / np.sqrt(variance[lit])))
    return LightCurve(shown, relative, np.array(error), light, last - 1, int(lit.sum()), over_noise)


def light_findings(curve: LightCurve, tolerance: float) -> Findings:
    """Return the step's findings, with a verdict on drift, order and noise."""
    falls = np.diff(curve.measured) + SURE * np.hypot(curve.error[1:], curve.error[:-1])
    usable = int(np.count_nonzero(np.diff(curve.light) > 1e-5))
    faults = []
    if curve.over_noise < LEAST_OVER_NOISE:
        faults.append(
            f"Too dark: full light is {curve.over_noise:.0f} times a pixel's noise, of the pixels "
            f"where it shows at all; {LEAST_OVER_NOISE:.0f} times or more are wanted. Take longer "
            "exposures, or open the aperture."
        )
    elif abs(curve.drift) > tolerance + 3 * float(curve.error[-1]):
        faults.append(
            f"The light changed by {curve.drift:+.2%} while the codes were shown, more than "
            f"{tolerance:.1%}: let the lamp warm up, and calibrate again."
        )
    if (falls < 0).any():
        code = int(curve.codes[1:][np.argmin(falls)])
        faults.append(
            f"Light falls at code {code}: switch off the projector's dynamic contrast and colour "
            "modes."
        )
    if curve.measured[-1] - curve.measured[0] < 0.5 or usable < CODES // 4:
        faults.append(
            f"Only {usable} of {CODES} codes differ in light: reset brightness, contrast."
        )
    middle = float(np.interp(0.5, curve.light, np.arange(CODES)))
    text = (
        f"{usable} steps of light; half the light is code {middle:.0f}; the lamp drifted by "
        f"{curve.drift:+.2%}."
    )
    return curve.findings(
        Verdict.of(faults, text),
        largest_error=float(curve.error.max()),
        code_of_half_light=middle,
    )
