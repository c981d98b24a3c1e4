"""The error of a prediction, from pictures that no fit sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.base import Float
from rfpipe.transport.base import Transport

HELD_OUT = 2
"""Pictures of each held-out pattern."""

MOST_HELD_OUT = 3 * HELD_OUT
"""Held-out pictures of an acquisition: of shapes, the strip and spots."""


@dataclass(frozen=True)
class Held:
    """Pictures (2 or 6, C, M) that no fit sees, each pattern's twice in a row.

    A pattern of random shapes, then the strip where most light stays near and small spots.
    """

    lit: NDArray[np.bool_]
    radiance: Float


@dataclass(frozen=True)
class Estimate:
    """Errors relative to the norm of a picture.

    Attributes
    ----------
    shapes : float
        Of a picture of random shapes.
    strip, spots : float
        Of the strip, and of small spots; as of shapes where they weren't shown, or noise drowns
        them: relative to hardly any light, all is wrong.
    dark : float
        Of random shapes on pixels that the projector leaves dark, where light is indirect; NaN
        where these aren't known.
    indirect : float
        All light on those pixels, in the same unit.
    """

    shapes: float
    strip: float
    spots: float
    dark: float = np.nan
    indirect: float = np.nan

    @property
    def error(self) -> float:
        """Expected of a picture: a quarter of what people relight is small spots."""
        return self.shapes / 2 + self.spots / 4 + self.strip / 4

    @property
    def is_noise(self) -> bool:
        """Whether most of the error is the noise of direct light, which no more pictures change.

        Dark pixels have none of it, and other pictures no more than random shapes.
        """
        worst = max(self.shapes, self.strip, self.spots)
        return self.dark < self.shapes / 2 and worst < 2 * self.shapes


def relit(transport: Transport, patterns: NDArray[Any]) -> Float:
    """Return a transport's pictures (P, C, M) of patterns (P, N) of white light."""
    shape = (len(patterns), transport.channels, patterns.shape[1])
    light = np.broadcast_to(patterns[:, None].astype(np.float32), shape)
    return transport.forward(light, range(transport.channels))


def error_of(
    transport: Transport,
    held: Held,
    known: NDArray[np.bool_],
    dark: NDArray[np.bool_] | None = None,
) -> Estimate:
    """Compare a transport's pictures with held-out ones, where pixels are `known`, (M,).

    `dark`, (M,), are those to which the first pattern sends no direct light, where that is known.
    """
    predicted = relit(transport, held.lit[::HELD_OUT]).repeat(HELD_OUT, axis=0)
    of_dark = None if dark is None else dark[known]
    return estimate(predicted[..., known], held.radiance[..., known], of_dark)


def estimate(predicted: Float, taken: Float, dark: NDArray[np.bool_] | None = None) -> Estimate:
    """Compare predicted with held-out pictures, float32 (2 or 6, C, M).

    Two pictures of one pattern have independent noise, so that the mean product of their errors is
    the squared error of the prediction alone, whatever the camera's noise may be.
    """
    pairs = [(predicted[k : k + 2], taken[k : k + 2]) for k in range(0, len(predicted), HELD_OUT)]
    shapes, light = _error(*pairs[0])
    others = [shapes if _drowned(pair[1]) else _error(*pair)[0] for pair in pairs[1:]]
    strip, spots = others or (shapes, shapes)
    if dark is None:
        return Estimate(shapes, strip, spots)
    on_dark, indirect, _ = _products(predicted[:2, ..., dark], taken[:2, ..., dark])
    return Estimate(shapes, strip, spots, _ratio(on_dark, light), _ratio(indirect, light))


def _error(predicted: Float, taken: Float) -> tuple[float, float]:
    """Return the relative error of a pattern's picture, and its squared light."""
    wrong, light, chance = _products(predicted, taken)
    # what chance makes of a sum of products is the least error that it can tell from none
    return _ratio(max(wrong, chance), light), light


def _drowned(taken: Float) -> bool:
    """Tell whether two pictures of a pattern have more noise than light."""
    one, other = taken.astype(np.float64)
    return float((one * other).sum()) < float(np.square(one - other).sum() / 2)


def _products(predicted: Float, taken: Float) -> tuple[float, float, float]:
    """Return the summed products of two pictures' errors, of their light, and the first's noise."""
    one, other = taken.astype(np.float64)
    first, second = predicted.astype(np.float64)
    product = (first - one) * (second - other)
    light = float((one * other).sum())
    if light <= 0:
        # of black pictures, light that was predicted is an error
        light = float((first * second).sum())
    return float(product.sum()), light, float(np.linalg.norm(product))


def _ratio(part: float, whole: float) -> float:
    return float(np.sqrt(max(part, 0.0) / whole)) if whole > 0 else 0.0
