"""Transports that an adaptive acquisition may return, and the best of them.

They are the model, the hierarchy, and the model with its residual. The best one has the smallest
estimated error on the held-out pictures (`rfpipe.methods.error_estimate`).
"""

from __future__ import annotations

from typing import NamedTuple

from rfpipe.methods.adaptive.model import AdaptiveModel
from rfpipe.methods.adaptive.state import HIERARCHY_METHOD, AdaptiveState
from rfpipe.methods.error_estimate import Estimate, estimate_error
from rfpipe.methods.images import Pictures
from rfpipe.methods.residual.model import CameraCells
from rfpipe.transport.base import Transport
from rfpipe.transport.sum import SumTransport


class Candidate(NamedTuple):
    """A transport that may be returned, and its estimated error."""

    estimate: Estimate
    transport: Transport


def best_candidate(
    state: AdaptiveState, model: AdaptiveModel, base: Candidate | None = None
) -> Candidate:
    """Return the transport that predicts the held-out pictures best.

    `base` is the best one without the residual, if it is known already.
    """
    base = best_without_residual(state, model) if base is None else base
    if state.residual is None:
        return base
    residual = state.residual.transport(camera_cells(state), state.projector.shape)
    transport = model.transport(list(state.rows), [residual])
    return min(base, _candidate(state, model, transport), key=error_of)


def best_without_residual(state: AdaptiveState, model: AdaptiveModel) -> Candidate:
    """Return the better of the model and the hierarchy, each without a residual."""
    of_model = model_candidate(state, model)
    if state.hierarchy_state is None:
        return of_model
    return min(of_model, hierarchy_candidate(state, model), key=error_of)


def model_candidate(state: AdaptiveState, model: AdaptiveModel) -> Candidate:
    """Return the model's transport without a residual."""
    return _candidate(state, model, model.transport(list(state.rows)))


def hierarchy_candidate(state: AdaptiveState, model: AdaptiveModel) -> Candidate:
    """Return the hierarchy's transport."""
    assert state.hierarchy_state is not None
    parts = HIERARCHY_METHOD.transport(state.hierarchy_state).parts
    return _candidate(state, model, SumTransport(parts, list(state.rows)))


def error_of(candidate: Candidate) -> float:
    """Return the estimated error of a candidate."""
    return candidate.estimate.error


def floodlit_of(state: AdaptiveState) -> Pictures:
    """Return the floodlit picture, which comes first."""
    assert state.floodlit is not None, "the floodlit picture comes first"
    return state.floodlit


def camera_cells(state: AdaptiveState) -> CameraCells:
    """Return the camera's cells of the residual."""
    return CameraCells.of_pictures(state.camera.shape, floodlit_of(state))


def _candidate(state: AdaptiveState, model: AdaptiveModel, transport: Transport) -> Candidate:
    """Estimate the error of a transport; it is 1 before the held-out pictures are taken."""
    if state.held_out is None:
        return Candidate(Estimate(1.0, 1.0, 1.0), transport)
    dark = model.dark_pixels(state.held_out.lit)
    estimate = estimate_error(transport, state.held_out, floodlit_of(state).floodlit, dark)
    return Candidate(estimate, transport)
