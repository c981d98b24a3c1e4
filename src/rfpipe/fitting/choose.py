"""Choice of the model that predicts held-out pictures best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import ceil, log2
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.fitting.faults import faults_of
from rfpipe.fitting.footprints import LEAST_PICTURES, solve_footprints, unfit_for_footprints
from rfpipe.fitting.held_out import dependents, held_out_pictures, mean_error, mean_picture
from rfpipe.fitting.least_squares import solve_least_squares, strange_pictures
from rfpipe.fitting.lights import check_lights
from rfpipe.fitting.near_far import solve_near_far, unfit_for_near_far
from rfpipe.fitting.noise import with_estimated_noise
from rfpipe.fitting.series import Series
from rfpipe.methods.images import nearest_known
from rfpipe.methods.states import level_row
from rfpipe.transport.base import Transport

Solve = Callable[[Series, list[dict[str, Any]]], Transport]

# Numbers of camera rays for estimating the error of least squares, whose rows are independent: the
# largest, and the smallest if twelve copies of their transport exceed the memory.
_ENOUGH_RAYS, _LEAST_RAYS, _COPIES = 512, 64, 12
# Error, relative to that of the mean picture, above which a note warns of a poor transport.
_HARDLY_BETTER = 0.7
# Contrast after binning, relative to the largest, above which a pattern counts as resolved.
_RESOLVED = 0.5
# Relative difference from their mean below which pictures of lights count as equal.
_EQUAL_PICTURES = 0.01
# More exchanges of pictures than these indicate that the order of all pictures is wrong.
_FEW_EXCHANGES = 3


@dataclass(frozen=True)
class FittingModel:
    """A model of the transport.

    Attributes
    ----------
    name : str
    solve : callable
        ``solve(series, rows)`` fits a transport with this table of levels.
    by_ray : bool
        True if camera rays are fitted independently.
    """

    name: str
    solve: Solve
    by_ray: bool = False


LEAST_SQUARES = FittingModel("least squares", solve_least_squares, by_ray=True)
FOOTPRINTS = FittingModel("footprints with smooth light", solve_footprints)
NEAR_FAR = FittingModel("near/far", solve_near_far)


@dataclass(frozen=True, eq=False)
class FittedTransport:
    """A transport fitted to pictures.

    Attributes
    ----------
    transport : Transport
        Fit to all pictures. Its ``history`` contains the error, if it is known.
    model : str
        Name of the model.
    complete : bool
        True if the patterns determine each projector ray without a prior.
    error : float or None
        Mean error of the pictures that were held out of a first fit, or of the validation
        pictures, relative to their norms and without their known noise. None if the fit needs all
        patterns.
    held_out : int
        Number of these pictures.
    errors : dict of str to float
        The same error for each model, and for ``the mean picture`` as prediction.
    notes : tuple of str
        Remarks for the user.
    """

    transport: Transport
    model: str
    complete: bool
    error: float | None
    held_out: int
    errors: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Trial:
    """Errors of models on pictures that no fit uses.

    Attributes
    ----------
    held_out : Series
    errors : dict of str to float
        Error by the name of the model.
    mean_picture : float
        Error of the mean picture, scaled by each pattern's light, as prediction.
    """

    held_out: Series
    errors: dict[str, float]
    mean_picture: float


def fit_transport(
    series: Series, *, coaxial: bool = False, anyway: bool = False, memory_gib: float = 2.0
) -> FittedTransport:
    """Fit the light transport to pictures, by the model that predicts held-out pictures best.

    Pictures of single lights with known directions become the columns of the transport. Their
    error is the mean error of interpolating each light from its neighbours.

    Parameters
    ----------
    series : Series
    coaxial : bool
        Camera and projector share their rays; the near/far model is then tried as well.
    anyway : bool
        Return the transport even if the pictures contradict each other, or if it predicts held-out
        pictures no better than their mean.
    memory_gib : float
        Largest size of a transport by least squares, in GiB.

    Raises
    ------
    InputError
        When the pictures of a coaxial rig don't allow the near/far model, or the pictures
        contradict each other or determine too little.
    """
    series = with_estimated_noise(series)
    if series.lights is not None and series.are_single_lights:
        return _fit_lights(series, anyway)
    models, training = _models(series, coaxial), series.training
    doubts, unsteady = _faults(training)
    _refuse(doubts, anyway)  # before the slow fits
    trial = _trial(series, models, memory_gib)
    if not doubts:
        doubts = _doubts(training, trial)
        _refuse(doubts, anyway)
    notes = [*series.notes, *unsteady, *doubts]
    errors = trial.errors if trial else {}
    best = min(models, key=lambda model: errors.get(model.name, np.inf))
    if best is LEAST_SQUARES:
        _check_memory(series, memory_gib)
    row = level_row(0, len(training.patterns))
    if trial:
        row["estimated_error"] = errors[best.name]
        if not doubts and errors[best.name] > _HARDLY_BETTER * trial.mean_picture:
            notes.append(_hardly_better(training, errors[best.name], trial.mean_picture))
    transport = best.solve(training, [row])
    transport.lights = series.lights
    transport.noise = _deviation(training)
    return FittedTransport(
        transport,
        best.name,
        training.is_complete,
        errors.get(best.name),
        len(trial.held_out.patterns) if trial else 0,
        {**errors, "the mean picture": trial.mean_picture} if trial else {},
        tuple(notes),
    )


def _fit_lights(series: Series, anyway: bool) -> FittedTransport:
    """Use pictures of single lights as a transport, with the error of interpolation."""
    assert series.lights is not None
    check = check_lights(series.radiance, series.lights, series.names, series.known)
    notes = list(series.notes)
    faults = [*check.faults, *_no_better_than_mean(series, check.error)]
    _refuse(faults, anyway)
    notes += faults
    if (series.lights[:, 2] < 0).all():
        notes.append("all lights are behind the object (z < 0); check the sign of z")
    is_known = bool(np.isfinite(check.error))
    row = level_row(0, len(series.patterns))
    if is_known:
        row["estimated_error"] = check.error
    transport = solve_least_squares(series, [row])
    transport.lights = series.lights
    error = check.error if is_known else None
    held_out = len(series.patterns) if is_known else 0
    return FittedTransport(transport, "single lights", True, error, held_out, notes=tuple(notes))


def _no_better_than_mean(series: Series, error: float) -> list[str]:
    """Return a message if interpolated pictures of lights are no better than their mean."""
    pictures = series.radiance[..., series.known].reshape(len(series.patterns), -1)
    count = len(pictures)
    if count < 4 or not np.isfinite(error):
        return []
    norms = np.linalg.norm(pictures, axis=1)
    means = (pictures.sum(axis=0) - pictures) / (count - 1)
    differences = np.linalg.norm(pictures - means, axis=1)
    by_mean = float(np.mean(differences[norms > 0] / norms[norms > 0]))
    if by_mean < _EQUAL_PICTURES:
        return [f"the pictures differ by only {by_mean:.1%}: each should show a different light."]
    # for 12 simulated domes, the ratio to the error of the mean was 0.19 to 0.95 with 4 lights, and
    # at most 0.61 with 16
    if error < by_mean:
        return []
    doubt = (
        f"held-out lights are predicted with an error of {error:.0%}, by the mean of the other "
        f"pictures with {by_mean:.0%}: check that the directions belong to the pictures."
    )
    return [doubt]


def _refuse(doubts: Sequence[str], anyway: bool) -> None:
    """Raise InputError with all doubts, if any, except with the option `anyway`."""
    if doubts and not anyway:
        sentences = [doubt if doubt.endswith((".", "?")) else f"{doubt}." for doubt in doubts]
        raise InputError(
            " ".join(sentences), remedy="To write the transport nevertheless: --anyway"
        )


def _deviation(series: Series) -> NDArray[np.float32]:
    """Return the noise of a picture, summed over channels, as a standard deviation (M,)."""
    noise = np.sqrt(series.variance.sum(axis=1).mean(axis=0))
    noise = np.where(series.known, noise, np.inf)
    return noise.reshape(series.camera_shape).astype(np.float32)


def _faults(series: Series) -> tuple[list[str], list[str]]:
    """Return messages on exchanged pictures and unknown codes, and on motion and flicker."""
    camera, projector = RayDomain(series.camera_shape), RayDomain(series.projector_shape)
    if series.patterns.shape[1] > 1 or camera.views > 1 or projector.views > 1:
        return [], []
    patterns = series.patterns[:, 0]
    names = series.names or [f"picture {index}" for index in range(len(patterns))]
    # stripes that binning makes uniform can't be distinguished
    contrast, mean = patterns.std(axis=1), patterns.mean(axis=1)
    is_resolved = (contrast > _RESOLVED * contrast.max(initial=0)) | (mean > 0.99)
    used = np.flatnonzero(is_resolved | (patterns == np.rint(patterns)).all(axis=1))
    # unknown pixels get the light of the nearest known pixel, which avoids edges
    light = series.radiance[used].sum(axis=1)[
        :, nearest_known(series.known.reshape(camera.image_shape))
    ]
    shapes = camera.image_shape, projector.image_shape
    faults = faults_of(patterns[used], light, *shapes, [names[int(index)] for index in used])
    exchanged = [fault.message for fault in faults if fault.kind == "exchanged"]
    unknown = [fault.message for fault in faults if fault.kind == "unknown codes"]
    unsteady = [fault.message for fault in faults if fault.kind in ("motion", "flicker")]
    if len(exchanged) > _FEW_EXCHANGES:
        order = (
            f"{len(exchanged)} pairs of pictures seem exchanged: check that no picture is missing "
            "or from another set, and that the code is the one that was displayed. The first: "
        )
        exchanged = [order + exchanged[0]]
    return [*exchanged, *unknown], unsteady


def _models(series: Series, coaxial: bool) -> list[FittingModel]:
    """Return the models for a rig and its pictures, the simplest first."""
    models = [LEAST_SQUARES]
    if not unfit_for_footprints(series.training):
        models.append(FOOTPRINTS)
    if coaxial:
        if reason := unfit_for_near_far(series):
            raise InputError(reason)
        models.append(NEAR_FAR)
    return models


def _trial(series: Series, models: list[FittingModel], memory_gib: float) -> _Trial | None:
    """Fit the models without held-out pictures and predict these; None if all are needed.

    Channels are summed, which saves time.
    """
    series = series.grey
    validation = np.flatnonzero(series.validation)
    chosen = validation if validation.size else held_out_pictures(series)
    unused = dependents(series, chosen)
    remaining = series.some(np.setdiff1d(np.arange(len(series.patterns)), unused))
    if not chosen.size or not len(remaining.patterns):
        return None
    # without redundancy, the remaining patterns don't determine a held-out picture
    if not validation.size and series.is_complete and not remaining.is_complete:
        return None
    held_out = series.some(chosen)
    errors = {}
    for model in models:
        if model is FOOTPRINTS and unfit_for_footprints(remaining):
            continue
        errors[model.name] = _error_of(model, remaining, held_out, memory_gib)
    predicted = mean_picture(remaining, held_out.patterns)
    return _Trial(held_out, errors, mean_error(predicted, held_out))


def _error_of(model: FittingModel, training: Series, held_out: Series, memory_gib: float) -> float:
    """Return the error of a model, fitted to training pictures, in the held-out pictures."""
    if model.by_ray:
        rays = np.flatnonzero(training.known)
        row_bytes = 4 * training.channels * training.patterns.shape[2]
        affordable = int(memory_gib * 2**30 / _COPIES / row_bytes)
        count = min(max(affordable, _LEAST_RAYS), _ENOUGH_RAYS)
        chosen = rays[np.unique(np.linspace(0, len(rays) - 1, count).astype(np.int64))]
        training, held_out = training.of_rays(chosen), held_out.of_rays(chosen)
    channels = range(held_out.channels)
    patterns = np.repeat(held_out.patterns, len(channels) // held_out.patterns.shape[1], axis=1)
    predicted: NDArray[np.float32] = model.solve(training, []).forward(patterns, channels)
    return mean_error(predicted, held_out)


def _doubts(series: Series, trial: _Trial | None) -> list[str]:
    """List contradictions of the pictures, and an error no better than the mean picture's."""
    if series.is_complete and (strange := strange_pictures(series)).size:
        names = series.names or [f"picture {index}" for index in range(len(series.patterns))]
        worst = ", ".join(names[index] for index in strange[:4])
        message = (
            f"pictures contradict the others, the worst first: {worst}. Check whether they are "
            "exchanged or turned"
        )
        return [message]
    if trial is None or min(trial.errors.values()) < trial.mean_picture:
        return []
    return [
        (
            f"held-out pictures are predicted with an error of {min(trial.errors.values()):.0%}, "
            f"by the mean picture, scaled by each pattern's light, with {trial.mean_picture:.0%}. "
            f"{_few_pictures(series)}."
        )
    ]


def _hardly_better(series: Series, error: float, by_mean: float) -> str:
    """Return a note on held-out pictures whose prediction is hardly better than their mean."""
    note = (
        f"held-out pictures are predicted with an error of {error:.0%}, hardly better than the "
        f"{by_mean:.0%} of the mean picture, scaled by each pattern's light: don't rely on detail "
        "as fine as theirs. correspondence() may be right nevertheless"
    )
    return note if _is_enough(series) else f"{note}. {_few_pictures(series)}"


def _code_bits(series: Series) -> int:
    """Return the number of bits of a Gray code for the projector's rows and columns."""
    return sum(max(1, ceil(log2(length))) for length in series.projector_shape[-2:])


def _is_enough(series: Series) -> bool:
    """Return True for at least as many independent patterns as a Gray code has, or as rays."""
    return bool(series.rank >= min(_code_bits(series) + 1, series.patterns.shape[2]))


def _few_pictures(series: Series) -> str:
    """Return advice on the number and quality of pictures."""
    bits, rank = _code_bits(series), series.rank
    code = 2 * bits + 2
    rays = series.patterns.shape[2]
    if not _is_enough(series):
        return (
            f"{rank} independent patterns are too few for {rays} rays: a Gray code for this "
            f"projector has {code} pictures with complements, white and black; take at least "
            f"{max(bits + 1 - rank, LEAST_PICTURES - rank, 1)} more"
        )
    advice = (
        f"{rank} independent patterns are enough for {rays} rays, so the pictures are in another "
        "order than the patterns, or too noisy, blurred or saturated. Expose dark pictures longer, "
        "average several pictures of each pattern, or bin the projector's pixels"
    )
    # a black picture is not in the series
    is_shorter = len(series.patterns) < code - 1
    if is_shorter:
        advice += f"; or take the {code} pictures of a Gray code with complements"
    return advice


def _check_memory(series: Series, memory_gib: float) -> None:
    """Raise InputError if a transport by least squares would be larger than the limit."""
    needed = series.channels * series.radiance.shape[2] * series.patterns.shape[2] * 4 / 2**30
    if needed > memory_gib:
        raise InputError(
            f"least squares needs {needed:.1f} GiB for {series.radiance.shape[2]:,} camera and "
            f"{series.patterns.shape[2]:,} projector rays, more than {memory_gib:g} GiB",
            remedy="use a larger --camera-bin, --projector-bin or --memory-gib",
        )
