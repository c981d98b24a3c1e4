"""Dual photography as the continuation of a footprint acquisition: levels of another number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import LevelImages, Pack
from rfpipe.methods.dual import Dual, DualOptions, DualState
from rfpipe.methods.footprints.state import FootprintState
from rfpipe.methods.images import FloodlitImage, renumbered
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.states import nested, nested_in
from rfpipe.patterns import Schedule

__all__ = ["begin", "most_patterns", "packed", "refine", "restored", "schedule"]

_PREFIX = "dual_"
# Mean errors of relit pictures in tolerances of dual photography: of scenes with glass and mirrors,
# where the model doesn't fit, they are 3 to 17, of diffuse scenes 1 to 6, more at small tolerances.
_UNFIT, _FIT = 10.0, 3.0
_COARSEST = 0.01  # tolerance


def begin(state: FootprintState, pictures: Pictures) -> DualState:
    """Start from the floodlit image, which is there already."""
    part = _UNFIT if state.unfit else _FIT
    tolerance = min(state.options.target_error / part, _COARSEST)
    begun = _start(state, tolerance)
    image = pictures.floodlit, pictures.floodlit_variance
    return Dual().refine(begun, FloodlitImage.of(state.camera, state.projector, *image))


def schedule(state: DualState, level: int) -> Schedule:
    """Return the next patterns under a level's number."""
    return replace(Dual().schedule(state), level=level)


def refine(state: DualState, images: LevelImages, memory_bytes: int) -> DualState:
    """Refine a level."""
    return Dual().refine(state, renumbered(images, state.level), memory_bytes)


def packed(state: DualState) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return a state's arrays, their names prefixed, and its attributes."""
    pack = Dual().pack(state)
    return nested(pack, _PREFIX), {**pack.attributes, "tolerance": state.options.tolerance}


def restored(start: FootprintState, packs: Sequence[Pack]) -> DualState | None:
    """Return the state after the last of packs, None where none of them has any."""
    own = nested_in(packs, _PREFIX, "dual")
    if not own:
        return None
    return Dual().restore(_start(start, own[0].attributes["tolerance"]), own)


def most_patterns(camera: RayDomain, projector: RayDomain) -> int:
    """Return those of a scene for which all blocks are lit one by one."""
    return Dual().most_patterns(camera, projector, DualOptions())


def _start(state: FootprintState, tolerance: float) -> DualState:
    options = DualOptions(noise_significance=state.options.noise_significance, tolerance=tolerance)
    return Dual().start(state.camera, state.projector, state.channels, options)
