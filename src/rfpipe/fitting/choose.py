"""Which model predicts pictures that it didn't see best, and how well."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.fitting.linear import solve_linear, strange_pictures
from rfpipe.fitting.series import Series
from rfpipe.methods.adaptive.residual import Canvas, residual_of
from rfpipe.methods.adaptive.smooth import as_transport, fit
from rfpipe.methods.images import Pictures
from rfpipe.methods.states import joined, level_row
from rfpipe.provenance import generator
from rfpipe.relighting import relative_errors
from rfpipe.transport.base import Transport


@dataclass(frozen=True, eq=False)
class Fit:
    """A transport behind pictures.

    Attributes
    ----------
    transport : Transport
        From all pictures. Its ``history`` has the error, where there is one.
    model : str
        ``least squares`` or ``near/far``.
    complete : bool
        Whether the patterns tell of each projector ray by itself.
    error : float or None
        Mean error of pictures that were left out of a first fit, or that the series has for
        validation, relative to their norms, less the noise that they are known to have. None where
        each pattern is needed.
    held_out : int
        These pictures.
    """

    transport: Transport
    model: str
    complete: bool
    error: float | None
    held_out: int


def fit_transport(series: Series, *, coaxial: bool = False, anyway: bool = False) -> Fit:
    """Find the light transport behind pictures.

    Parameters
    ----------
    series : Series
    coaxial : bool
        Whether camera and projector share their rays. Near/far's model is fitted, too, and taken
        where it predicts pictures better that are left out of the fits.
    anyway : bool
        Whether to return a transport that is worth little, too.

    Raises
    ------
    InputError
        When the pictures of a coaxial rig don't allow near/far's model; when pictures contradict
        the others, or the patterns tell of little more than the mean picture.
    """
    models = {"least squares": solve_linear}
    if coaxial:
        _check_coaxial(series)
        models["near/far"] = _solve_near_far
    training, validates = series.training, series.validation.any()
    held = np.flatnonzero(series.validation) if validates else _held_out(series)
    rest = series.some(np.setdiff1d(np.arange(len(series.patterns)), held))
    complete, left_out = training.is_complete, series.some(held)
    errors: dict[str, float] = {}
    # of patterns that are just complete, one that is left out isn't told of by the others
    if validates or (held.size and not (complete and not rest.is_complete)):
        colours = range(series.channels)
        shown = np.repeat(left_out.patterns, len(colours) // left_out.patterns.shape[1], axis=1)
        errors = {
            name: _error(solve(rest, []).forward(shown, colours), left_out)
            for name, solve in models.items()
        }
    best = min(errors, key=lambda name: errors[name]) if errors else "least squares"
    row = level_row(0, len(training.patterns))
    if errors:
        row["estimated_error"] = errors[best]
        doubts = _doubts(training, rest, left_out, errors[best])
        if doubts and not anyway:
            raise InputError(f"{doubts} To take them all the same: --anyway")
    transport = models[best](training, [row])
    transport.lights = series.lights
    return Fit(transport, best, complete, errors.get(best), len(held) if errors else 0)


def _doubts(series: Series, rest: Series, held: Series, error: float) -> str:
    """Say which pictures contradict the others, or that the fit is hardly better than a mean."""
    if (strange := strange_pictures(series)).size:
        names = series.names or [f"picture {index}" for index in range(len(series.patterns))]
        worst = ", ".join(names[index] for index in strange[:4])
        return f"pictures don't fit the others, the worst first: {worst}. Exchanged, or turned?"
    light = rest.patterns.mean(axis=(0, 2), dtype=np.float64)
    mean = rest.radiance.mean(axis=0, dtype=np.float64) / light[:, None]
    by_mean = _error(held.patterns.mean(axis=2)[..., None] * mean, held)
    if error <= 0.5 * by_mean:
        return ""
    rank, rays = series.rank, series.patterns.shape[-1]
    return (
        f"left-out pictures are off by {error:.0%}, by {by_mean:.0%} where each is taken for the "
        f"mean one: {rank} independent patterns tell too little of {rays} rays. Take "
        f"{max(rays - rank, 0)} more and in less noise, see that none are exchanged, or give "
        "--coaxial where camera and projector share their rays."
    )


def _check_coaxial(series: Series) -> None:
    patterns, white = series.patterns, series.patterns.all(axis=-1)
    if series.camera_shape != series.projector_shape:
        raise InputError(
            f"a coaxial rig has one shape of rays, not {series.camera_shape} camera and "
            f"{series.projector_shape} projector rays"
        )
    are_binary = patterns.shape[1] == 1 and ((patterns == 0) | (patterns == 1)).all()
    if not are_binary or not white.any() or white.all():
        raise InputError(
            "the model of coaxial rigs needs a picture of white light, and others of patterns "
            "whose weights are 0 or 1; add them, or leave out --coaxial"
        )


def _solve_near_far(series: Series, rows: list[dict[str, Any]]) -> Transport:
    """Return direct and smooth indirect light, and what they leave of the pictures."""
    shape, lit = series.projector_shape, series.patterns[:, 0] > 0
    white = lit.all(axis=1)
    radiance = series.radiance[white].mean(axis=0, dtype=np.float64)[None].astype(np.float32)
    spread = series.variance[white].mean(axis=0, dtype=np.float64)[None] / np.count_nonzero(white)
    floodlit = Pictures(lit[white][:1], radiance, spread.astype(np.float32)).completed(shape)
    others = Pictures(lit[~white], series.radiance[~white], series.variance[~white])
    pictures = joined([floodlit, others], axis=0)
    model = fit(shape, pictures)
    canvas = Canvas.of(shape, pictures)
    taken = canvas.taken(pictures.lit, pictures.radiance, pictures.variance)
    residual = residual_of(canvas, taken, as_transport(shape, [], model, pictures))
    return as_transport(shape, rows, model, pictures, [residual.transport(canvas, shape)])


def _held_out(series: Series) -> NDArray[np.int64]:
    """Choose an eighth of the pictures to leave out, 16 at most; of fewer than 8, half.

    Neither white nor black ones, whose light others know.
    """
    patterns = series.patterns.max(axis=1)
    free = np.flatnonzero(~(patterns.min(axis=1) > 0) & patterns.any(axis=1))
    count = min(len(free) // (8 if len(free) >= 8 else 2), 16)
    return np.sort(generator(0, len(free)).choice(free, count, replace=False)).astype(np.int64)


def _error(guess: NDArray[Any], held: Series) -> float:
    """Return the mean error of a guess at pictures that aren't black, less their own noise."""
    residual = guess - held.radiance
    wrong = np.square(residual, dtype=np.float64).sum(axis=(1, 2))
    wrong -= held.variance.sum(axis=(1, 2), dtype=np.float64)
    light = np.square(held.radiance, dtype=np.float64).sum(axis=(1, 2))
    errors = relative_errors(wrong, light)[light > 0]
    return float(errors.mean()) if errors.size else 0.0
