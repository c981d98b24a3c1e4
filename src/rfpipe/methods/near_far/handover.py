"""Symmetric photography as the continuation of a near/far acquisition: levels of another number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import ErrorOptions, LevelImages, Pack
from rfpipe.methods.images import FloodlitImage, renumbered
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.states import nested, nested_in
from rfpipe.methods.symmetric.method import Symmetric, SymmetricOptions, SymmetricState
from rfpipe.patterns import Schedule

__all__ = ["begin", "packed", "refine", "restored", "schedule"]

_PREFIX = "symmetric_"
_COARSEST = 0.01  # tolerance


def begin(domain: RayDomain, options: ErrorOptions, pictures: Pictures) -> SymmetricState:
    """Start from the floodlit image, which is there already."""
    begun = Symmetric().start(domain, domain, pictures.channels, _own(options))
    image = pictures.floodlit, pictures.floodlit_variance
    return Symmetric().refine(begun, FloodlitImage.of(domain, domain, *image))


def schedule(state: SymmetricState, level: int) -> Schedule:
    """Return the next patterns under a level's number."""
    return replace(Symmetric().schedule(state), level=level)


def refine(state: SymmetricState, images: LevelImages, memory_bytes: int) -> SymmetricState:
    """Refine a level."""
    return Symmetric().refine(state, renumbered(images, state.level), memory_bytes)


def packed(state: SymmetricState) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Return a state's arrays, their names prefixed, and its attributes."""
    pack = Symmetric().pack(state)
    return nested(pack, _PREFIX), dict(pack.attributes)


def restored(
    domain: RayDomain, channels: int, options: ErrorOptions, packs: Sequence[Pack]
) -> SymmetricState | None:
    """Return the state after the last of packs, None where none of them has any."""
    own = nested_in(packs, _PREFIX, "symmetric")
    if not own:
        return None
    method = Symmetric()
    return method.restore(method.start(domain, domain, channels, _own(options)), own)


def _own(options: ErrorOptions) -> SymmetricOptions:
    """Return symmetric photography's options: a hierarchy that goes part of the way to the target.

    Of the benchmark's coaxial scenes, relit pictures are off by one to five tolerances of a
    hundredth, and by no less at larger ones; the pictures of all levels together more than halve
    that.
    """
    tolerance = min(options.target_error, _COARSEST)
    return SymmetricOptions(noise_significance=options.noise_significance, tolerance=tolerance)
