"""Dual photography as the continuation of a footprint acquisition."""

from __future__ import annotations

from collections.abc import Sequence

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import Pack
from rfpipe.methods.dual import Dual, DualOptions, DualState
from rfpipe.methods.footprints.state import FootprintState
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.nested import Nested

__all__ = ["DUAL", "begin", "most_patterns", "packed", "restored"]

DUAL = Nested(Dual(), "dual")

# Mean errors of relit pictures in tolerances of dual photography: of scenes with glass and mirrors,
# where the model doesn't fit, they are 3 to 17, of diffuse scenes 1 to 6, more at small tolerances.
_UNFIT, _FIT = 10.0, 3.0
_COARSEST = 0.01  # tolerance


def begin(state: FootprintState, pictures: Pictures) -> DualState:
    """Start from the floodlit image, which is there already."""
    part = _UNFIT if state.unfit else _FIT
    start = _start(state, min(state.options.target_error / part, _COARSEST))
    return DUAL.begun(start, pictures.floodlit, pictures.floodlit_variance)


def packed(state: DualState) -> Pack:
    """Return a state as part of a pack, with the tolerance."""
    return DUAL.packed(state, tolerance=state.options.tolerance)


def restored(start: FootprintState, packs: Sequence[Pack]) -> DualState | None:
    """Return the state after the last of packs, None where none of them has any."""
    return DUAL.restored(packs, lambda attributes: _start(start, attributes["tolerance"]))


def most_patterns(camera: RayDomain, projector: RayDomain) -> int:
    """Return those of a scene for which all blocks are lit one by one."""
    return Dual().most_patterns(camera, projector, DualOptions())


def _start(state: FootprintState, tolerance: float) -> DualState:
    options = DualOptions(noise_significance=state.options.noise_significance, tolerance=tolerance)
    return Dual().start(state.camera, state.projector, state.channels, options)
