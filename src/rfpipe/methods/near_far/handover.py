"""Symmetric photography as the continuation of a near/far acquisition."""

from __future__ import annotations

from collections.abc import Sequence

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import ErrorOptions, Pack
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.nested import Nested
from rfpipe.methods.symmetric.method import Symmetric, SymmetricOptions, SymmetricState

__all__ = ["SYMMETRIC", "begin", "restored"]

SYMMETRIC = Nested(Symmetric(), "symmetric")

_COARSEST = 0.01  # tolerance


def begin(domain: RayDomain, options: ErrorOptions, pictures: Pictures) -> SymmetricState:
    """Start from the floodlit image, which is there already."""
    start = _start(domain, pictures.channels, options)
    return SYMMETRIC.begun(start, pictures.floodlit, pictures.floodlit_variance)


def restored(
    domain: RayDomain, channels: int, options: ErrorOptions, packs: Sequence[Pack]
) -> SymmetricState | None:
    """Return the state after the last of packs, None where none of them has any."""
    return SYMMETRIC.restored(packs, lambda _: _start(domain, channels, options))


def _start(domain: RayDomain, channels: int, options: ErrorOptions) -> SymmetricState:
    """Return the state before the floodlit image, of a hierarchy that goes part of the way.

    Of the benchmark's coaxial scenes, relit pictures are off by one to five tolerances of a
    hundredth, and by no less at larger ones; the pictures of all levels together more than halve
    that.
    """
    own = SymmetricOptions(
        noise_significance=options.noise_significance,
        tolerance=min(options.target_error, _COARSEST),
    )
    return Symmetric().start(domain, domain, channels, own)
