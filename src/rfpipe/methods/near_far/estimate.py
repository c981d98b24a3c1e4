"""The error of a prediction, from held-out pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float

__all__ = ["Estimate", "Held", "estimate"]

# The strip where most light stays near is the worst case; of the pictures that people relight,
# about one in so many lights such places by much.
_WORST = 3


@dataclass(frozen=True)
class Held:
    """Pictures that no fit sees, each pattern's twice in a row.

    Attributes
    ----------
    lit : ndarray of bool, shape (2 or 4, N)
        A pattern of random shapes, then the strip where most light stays near.
    radiance : ndarray of float32, shape (2 or 4, C, N)
    """

    lit: NDArray[np.bool_]
    radiance: Float

    def at(self, pixels: NDArray[np.bool_]) -> Held:
        """Return what some pixels (N,) show."""
        return Held(self.lit[:, pixels], self.radiance[..., pixels])


@dataclass(frozen=True)
class Estimate:
    """Errors relative to the norm of a picture.

    Attributes
    ----------
    error : float
        Expected of a picture: of random shapes mostly, sometimes of the strip.
    worst : float
        Of the strip, as far as it is known.
    dark : float
        Of random shapes on pixels that the projector leaves dark, where light is indirect.
    indirect : float
        All light on those pixels, in the same unit.
    """

    error: float
    worst: float
    dark: float
    indirect: float

    @property
    def is_noise(self) -> bool:
        """Whether most of the error is the noise of direct light, which no more pictures change.

        Dark pixels have none of it, and the strip no more than others.
        """
        typical = (_WORST * self.error - self.worst) / (_WORST - 1)
        return self.dark < typical / 2 and self.worst < 2 * typical


def estimate(predicted: Float, held: Held) -> Estimate:
    """Compare predicted with held-out pictures.

    Two pictures of one pattern have independent noise, so that the mean product of what is wrong
    with either is the squared error of the prediction alone, whatever the camera's noise may be.

    Parameters
    ----------
    predicted : ndarray of float32, shape (2 or 4, C, N)
    held : Held
    """
    dark = ~held.lit[0]
    everywhere = np.ones_like(dark)
    typical, light, chance = _products(predicted[:2], held.radiance[:2], everywhere)
    on_dark, indirect, _ = _products(predicted[:2], held.radiance[:2], dark)
    # what chance makes of a sum of products is the least error that it can tell from none
    error = worst = _ratio(max(typical, chance), light)
    if len(held.lit) > 2:
        on_strip, strip, chance = _products(predicted[2:], held.radiance[2:], everywhere)
        worst = _ratio(max(on_strip, chance), strip)
        error = ((_WORST - 1) * error + worst) / _WORST
    return Estimate(error, worst, _ratio(on_dark, light), _ratio(indirect, light))


def _products(
    predicted: Float, taken: Float, where: NDArray[np.bool_]
) -> tuple[float, float, float]:
    """Return the summed products of two pictures' errors, of their light, and the first's noise."""
    one, other = taken[..., where].astype(np.float64)
    first, second = predicted[..., where].astype(np.float64)
    product = (first - one) * (second - other)
    light = float((one * other).sum())
    if light <= 0:
        # of black pictures, light that was predicted is an error
        light = float((first * second).sum())
    return float(product.sum()), light, float(np.linalg.norm(product))


def _ratio(part: float, whole: float) -> float:
    return float(np.sqrt(max(part, 0.0) / whole)) if whole > 0 else 0.0
