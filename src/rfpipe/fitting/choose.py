"""Which model predicts pictures that it didn't see best, and how well."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.fitting.coaxial import floodlit_of, near_far_models
from rfpipe.fitting.linear import Linear, solve_linear
from rfpipe.fitting.series import Series
from rfpipe.methods.states import level_row
from rfpipe.provenance import generator
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.transport.base import Transport

__all__ = ["Fit", "Models", "fit_transport"]

Models = Literal["best", "linear", "near_far"]

# Of the pictures, those that are left out to see how well they are predicted.
_HELD_OUT, _MOST_HELD_OUT = 8, 16
_LINEAR = "linear"

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Fit:
    """What was found.

    Attributes
    ----------
    transport : Transport
        From all pictures. Its ``history`` has the error, where there is one.
    model : str
        What it is: ``linear``, ``near_far``, or ``near_far and what it leaves``.
    complete : bool
        Whether the patterns tell of each projector ray by itself.
    errors : dict of str to float
        By model: error of pictures that were left out of its fit, relative to their norms, in the
        mean; less the noise that the pictures themselves are known to have.
    noise : float or None
        Error of relit pictures that the pictures' noise makes, relative to their norm, where the
        patterns are complete and noise is known.
    held_out : int
        Pictures that were left out.
    """

    transport: Transport
    model: str
    complete: bool
    errors: dict[str, float]
    noise: float | None
    held_out: int

    @property
    def error(self) -> float | None:
        """Estimated error of relit pictures: of noise where patterns are complete, else left-out.

        None where they are complete, nothing is known of noise, and none can be left out.
        """
        if self.noise is not None:
            return self.noise
        return self.errors.get(self.model)


def fit_transport(series: Series, *, coaxial: bool = False, model: Models = "best") -> Fit:
    """Find the light transport behind pictures.

    Parameters
    ----------
    series : Series
    coaxial : bool
        Whether camera and projector share their rays, so that near/far's model may be taken.
    model : {"best", "linear", "near_far"}
        Regularised least squares, near/far's model, or whichever predicts pictures better that are
        left out of the fit.

    Raises
    ------
    InputError
        When near/far's model is asked for and the pictures don't allow it.
    """
    allowed = _why_not(series, coaxial)
    if model == "near_far" and allowed:
        raise InputError(f"near/far's model can't be fitted: {allowed}")
    complete = series.is_complete
    kinds = [model] if model != "best" else [_LINEAR, "near_far"]
    if allowed or (model == "best" and complete):
        kinds = [_LINEAR]
    held = _held_out(series)
    rest = np.setdiff1d(np.arange(len(series.patterns)), held)
    errors: dict[str, float] = {}
    # of patterns that are just complete, one that is left out isn't told of by the others
    tells = bool(held.size) and not (complete and not series.some(rest).is_complete)
    if tells:
        for name, found in _models(series.some(rest), kinds, []):
            errors[name] = _error(found, series.some(held))
            _log.info("%s: left-out pictures are off by %.3g %%", name, 100 * errors[name])
    best = min(errors, key=lambda name: errors[name]) if errors else kinds[0]
    noise = None
    if complete and best == _LINEAR and series.variance.any():
        noise = _noise(solve_linear(series), series)
    row = level_row(0, len(series.patterns), rank_k=0)
    error = noise if noise is not None else errors.get(best)
    if error is not None:
        row["estimated_error"] = error
    transport = dict(_models(series, [_LINEAR if best == _LINEAR else "near_far"], [row]))[best]
    return Fit(transport, best, complete, errors, noise, len(held) if tells else 0)


def _models(
    series: Series, kinds: list[Any], rows: list[dict[str, Any]]
) -> Iterator[tuple[str, Transport]]:
    """Yield the models of some kinds, fitted to pictures."""
    if _LINEAR in kinds:
        found = solve_linear(series)
        _log.info("least squares: entries alike over %g rays", found.scale)
        yield _LINEAR, found.transport(series, rows)
    if "near_far" in kinds and floodlit_of(series) is not None:
        yield from near_far_models(series, rows)


def _why_not(series: Series, coaxial: bool) -> str:
    """Say why near/far's model doesn't fit, nothing where it does."""
    if not coaxial:
        return "it is for coaxial rigs, whose camera and projector share their rays (--coaxial)"
    if series.camera_shape != series.projector_shape:
        return (
            f"a coaxial rig has one shape of rays, not {series.camera_shape} camera and "
            f"{series.projector_shape} projector rays"
        )
    if not series.is_binary:
        return "its patterns are of light and dark alone, 0 and 1"
    if floodlit_of(series) is None:
        return "it needs a picture under white light, or those of a pattern and its opposite"
    if not (~series.patterns.all(axis=1) & series.patterns.any(axis=1)).any():
        return "there is no picture but of white and black"
    return ""


def _held_out(series: Series) -> NDArray[np.int64]:
    """Choose pictures to leave out: neither white nor black ones, whose light others know."""
    white, dark = series.patterns.min(axis=1) > 0, ~series.patterns.any(axis=1)
    free = np.flatnonzero(~white & ~dark)
    count = min(
        len(free) // _HELD_OUT if len(free) >= _HELD_OUT else len(free) // 2, _MOST_HELD_OUT
    )
    return np.sort(generator(0, len(free)).choice(free, count, replace=False)).astype(np.int64)


def _error(found: Transport, held: Series) -> float:
    """Return the mean error of pictures, less the noise that they are known to have."""
    channels = range(held.channels)
    shape = (len(held.patterns), held.channels, held.patterns.shape[1])
    relit = found.forward(np.broadcast_to(held.patterns[:, None], shape), channels)
    wrong = np.square(relit - held.radiance, dtype=np.float64).sum(axis=(1, 2))
    wrong = np.maximum(wrong - held.variance.sum(axis=(1, 2), dtype=np.float64), 0)
    light = np.square(held.radiance, dtype=np.float64).sum(axis=(1, 2))
    lit = light > 0
    return float(np.sqrt(wrong[lit] / light[lit]).mean()) if lit.any() else 0.0


def _noise(found: Linear, series: Series) -> float:
    """Return the mean error of relit pictures that noise makes."""
    patterns = np.stack(list(relighting_patterns(series.projector_shape).values()))
    patterns = patterns.reshape(len(patterns), -1).astype(np.float32)
    shape = (len(patterns), series.channels, patterns.shape[1])
    images = found.transport(series, []).forward(
        np.broadcast_to(patterns[:, None], shape), range(series.channels)
    )
    light = np.square(images, dtype=np.float64).sum(axis=(1, 2))
    lit = light > 0
    spread = found.noise_of(patterns).sum(axis=(1, 2))
    return float(np.sqrt(spread[lit] / light[lit]).mean()) if lit.any() else 0.0
