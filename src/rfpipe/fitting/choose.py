"""Which model predicts pictures that it didn't see best, and how well."""

from __future__ import annotations

import logging
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.fitting.folder import Float, Series
from rfpipe.fitting.linear import Linear, solve_linear
from rfpipe.methods.adaptive.residual import Canvas, residual_of
from rfpipe.methods.adaptive.smooth import as_transport, fit
from rfpipe.methods.images import Pictures
from rfpipe.methods.states import joined, level_row
from rfpipe.provenance import generator
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.transport.base import Transport

Models = Literal["best", "linear", "near_far"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Fit:
    """A transport behind pictures.

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
        return self.errors.get(self.model) if self.noise is None else self.noise


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
    obstacle = _why_not(series, coaxial)
    if model == "near_far" and obstacle:
        raise InputError(f"near/far's model can't be fitted: {obstacle}")
    complete = series.is_complete
    kinds = {"linear", "near_far"} if model == "best" else {model}
    if obstacle or (model == "best" and complete):
        kinds = {"linear"}
    held = _held_out(series)
    rest = np.setdiff1d(np.arange(len(series.patterns)), held)
    errors: dict[str, float] = {}
    # of patterns that are just complete, one that is left out isn't told of by the others
    if held.size and not (complete and not series.some(rest).is_complete):
        for name, found in _models(series.some(rest), kinds, []):
            errors[name] = _error(found, series.some(held))
            _log.info("%s: left-out pictures are off by %.3g %%", name, 100 * errors[name])
    best = min(errors, key=lambda name: errors[name]) if errors else min(kinds)
    noise = None
    if complete and best == "linear" and series.variance.any():
        noise = _noise(solve_linear(series), series)
    row = level_row(0, len(series.patterns), rank_k=0)
    error = noise if noise is not None else errors.get(best)
    if error is not None:
        row["estimated_error"] = error
    fitted = dict(_models(series, {"linear" if best == "linear" else "near_far"}, [row]))
    return Fit(fitted[best], best, complete, errors, noise, len(held) if errors else 0)


def _models(
    series: Series, kinds: Collection[str], rows: list[dict[str, Any]]
) -> Iterator[tuple[str, Transport]]:
    """Yield the models of some kinds, fitted to pictures; `rows` is the table of levels.

    Near/far's are direct and smooth indirect light, and the same with what it leaves.
    """
    if "linear" in kinds:
        found = solve_linear(series)
        _log.info("least squares: entries alike over %g rays", found.scale)
        yield "linear", found.transport(series, rows)
    known = _floodlit(series)
    if "near_far" not in kinds or known is None:
        return
    shape, white = series.projector_shape, np.ones((1, series.patterns.shape[1]), np.bool_)
    telling = ~series.patterns.all(axis=1) & series.patterns.any(axis=1)
    probes = (series.patterns[telling] > 0, series.radiance[telling], series.variance[telling])
    pictures = joined([Pictures(white, *known).completed(shape), Pictures(*probes)], axis=0)
    model = fit(shape, pictures)
    smooth = as_transport(shape, rows, model, pictures)
    yield "near_far", smooth
    canvas = Canvas.of(shape, pictures)
    taken = canvas.taken(pictures.lit, pictures.radiance, pictures.variance)
    rest = residual_of(canvas, taken, smooth).transport(canvas)
    yield "near_far and what it leaves", as_transport(shape, rows, model, pictures, [rest])


def _floodlit(series: Series) -> tuple[Float, Float] | None:
    """Return the floodlit image (1, C, M) and its variance: of white pictures, else of opposites.

    None where there are neither, or the patterns aren't of light and dark.
    """
    if not series.is_binary:
        return None
    white = series.patterns.all(axis=1)
    if white.any():
        mean = series.radiance[white].mean(axis=0, dtype=np.float64)[None]
        spread = series.variance[white].mean(axis=0, dtype=np.float64)[None]
        spread /= np.count_nonzero(white)
        return mean.astype(np.float32), spread.astype(np.float32)
    number = {pattern.tobytes(): index for index, pattern in enumerate(series.patterns)}
    for index, pattern in enumerate(series.patterns):
        other = number.get((1 - pattern).astype(np.float32).tobytes())
        if other is not None:
            pair = [index, other]
            return series.radiance[pair].sum(0)[None], series.variance[pair].sum(0)[None]
    return None


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
    if _floodlit(series) is None:
        return "it needs a picture under white light, or those of a pattern and its opposite"
    if series.patterns.all(axis=1).all():
        return "there is no picture but of white"
    return ""


def _held_out(series: Series) -> NDArray[np.int64]:
    """Choose an eighth of the pictures to leave out, 16 at most; of fewer than 8, half.

    Neither white nor black ones, whose light others know.
    """
    free = np.flatnonzero(~(series.patterns.min(axis=1) > 0) & series.patterns.any(axis=1))
    count = min(len(free) // (8 if len(free) >= 8 else 2), 16)
    return np.sort(generator(0, len(free)).choice(free, count, replace=False)).astype(np.int64)


def _relit(found: Transport, patterns: Float) -> Float:
    """Return pictures (P, C, M) of patterns (P, N)."""
    shape = (len(patterns), found.channels, patterns.shape[1])
    return found.forward(np.broadcast_to(patterns[:, None], shape), range(found.channels))


def _error(found: Transport, held: Series) -> float:
    """Return the mean error of pictures, less the noise that they are known to have."""
    relit = _relit(found, held.patterns)
    wrong = np.square(relit - held.radiance, dtype=np.float64).sum(axis=(1, 2))
    return _mean_ratio(wrong - held.variance.sum(axis=(1, 2), dtype=np.float64), held.radiance)


def _noise(found: Linear, series: Series) -> float:
    """Return the mean error of relit pictures that noise makes."""
    patterns = np.stack(list(relighting_patterns(series.projector_shape).values()))
    patterns = patterns.reshape(len(patterns), -1).astype(np.float32)
    images = _relit(found.transport(series, []), patterns)
    return _mean_ratio(found.noise_of(patterns).sum(axis=(1, 2)), images)


def _mean_ratio(wrong: NDArray[np.float64], images: Float) -> float:
    """Return the mean root of squared errors over the norms of pictures that aren't black."""
    light = np.square(images, dtype=np.float64).sum(axis=(1, 2))
    lit = light > 0
    return float(np.sqrt(np.maximum(wrong[lit], 0) / light[lit]).mean()) if lit.any() else 0.0
