"""Captured pictures beside their relit twins: how far apart they are, and how far noise is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Compared", "Verification", "compare"]

Float = NDArray[np.float32]


@dataclass(frozen=True)
class Compared:
    """One picture that no method saw, captured and relit.

    Attributes
    ----------
    name : str
    difference : float
        ``||relit - captured|| / ||captured||``, over the rays that the camera knows.
    noise : float
        What of it the captured picture's own noise is expected to make: the noise floor.
    error, standard_error : float
        The difference without the noise's share; 0 where nothing but noise is seen. NaN where the
        picture has no light.
    """

    name: str
    difference: float
    noise: float
    error: float
    standard_error: float


@dataclass(frozen=True, eq=False)
class Verification:
    """What a transport is wrong by, on pictures that were captured for this alone.

    Attributes
    ----------
    compared : tuple of Compared
    patterns : ndarray of float32, shape (P, *projector_shape)
    captured, relit : ndarray of float32, shape (P, *camera_shape, C)
        Radiance; rays that the camera doesn't know are 0 in both.
    gain : ndarray of float64, shape (C,)
        Light of the lamp, relative to that at the acquisition's beginning; it is divided out of
        the captured pictures.
    """

    compared: tuple[Compared, ...]
    patterns: Float
    captured: Float
    relit: Float
    gain: NDArray[np.float64]

    @property
    def mean_error(self) -> float:
        """Mean of the pictures' errors; NaN where none has light."""
        errors = [one.error for one in self._lit]
        return float(np.mean(errors)) if errors else float("nan")

    @property
    def worst(self) -> Compared:
        """The picture of the largest error."""
        return max(self._lit or self.compared, key=lambda one: one.error)

    @property
    def table(self) -> pd.DataFrame:
        """A row a picture: the fields of `Compared`."""
        import pandas as pd

        return pd.DataFrame([vars(one) for one in self.compared])

    @property
    def _lit(self) -> list[Compared]:
        return [one for one in self.compared if np.isfinite(one.error)]

    def facts(self) -> dict[str, Any]:
        """Return plain data for a manifest; None for what isn't known."""
        pictures = [
            {name: _known(value) for name, value in vars(one).items()} for one in self.compared
        ]
        return {
            "pictures": pictures,
            "mean_error": _known(self.mean_error),
            "worst_error": _known(self.worst.error),
            "worst_picture": self.worst.name,
            "noise": _known(float(np.mean([one.noise for one in self._lit] or [np.nan]))),
            "gain": [float(gain) for gain in self.gain],
        }


def _known(value: str | float) -> str | float | None:
    return None if isinstance(value, float) and not np.isfinite(value) else value


def compare(
    names: Sequence[str],
    patterns: Float,
    captured: tuple[Float, Float],
    relit: Float,
    gain: NDArray[np.float64],
) -> Verification:
    """Compare captured pictures with relit ones.

    Parameters
    ----------
    names : sequence of P str
    patterns : ndarray of float32, shape (P, *projector_shape)
    captured : tuple of two ndarrays of float32, shape (P, *camera_shape, C)
        Radiance and its variance, infinite where the camera doesn't know it.
    relit : ndarray of float32, shape (P, *camera_shape, C)
    gain : ndarray of float64, shape (C,)
        As `Verification`.

    Notes
    -----
    With ``d = relit - captured`` and the variance v of each sample, ``sum d^2`` is expected to be
    ``sum (error^2 + v)``: the noise's share is known, and is taken off. What is left has the
    standard deviation ``sqrt(sum (2 v^2 + 4 v error^2))``. The noise of the transport itself is
    part of its error.
    """
    radiance, variance = captured
    known = np.isfinite(variance)
    seen, drawn = np.where(known, radiance, 0), np.where(known, relit, 0)
    found = [
        _compared(name, seen[index], drawn[index], np.where(known[index], variance[index], 0))
        for index, name in enumerate(names)
    ]
    return Verification(tuple(found), patterns, seen, drawn, np.asarray(gain, np.float64))


def _compared(name: str, seen: Float, drawn: Float, variance: Float) -> Compared:
    v = variance.astype(np.float64)
    squares, noise = np.square(drawn.astype(np.float64) - seen), float(v.sum())
    light = float(np.square(seen, dtype=np.float64).sum()) - noise
    if light <= 0:
        return Compared(name, *[float("nan")] * 4)
    error = np.sqrt(max(float(squares.sum()) - noise, 0.0))
    spread = float(np.sqrt((2 * np.square(v) + 4 * v * np.maximum(squares - v, 0)).sum()))
    # far from zero half the relative error of the square; near it, the root of its spread
    deviation = min(np.sqrt(spread), spread / (2 * error) if error else np.inf)
    scale = np.sqrt(light)
    return Compared(
        name,
        float(np.sqrt(squares.sum()) / scale),
        float(np.sqrt(noise) / scale),
        float(error / scale),
        float(deviation / scale),
    )
