"""What light of a physically based scene is followed."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["MERGING_RADIUS", "Light"]

# Within which light counts as that of a place which the camera sees by mirrors and lenses, relative
# to the footprint of a pixel there.
MERGING_RADIUS = 0.5


@dataclass(frozen=True)
class Light:
    """What light is followed, and how long.

    Attributes
    ----------
    bounces : int
        Most vertices of a path between projector and camera, at least 1: direct light alone.
    samples : int
        Paths a pixel, at least 2: half of them for either half.
    caustics : bool
        Whether light that the projector sends by mirrors and lenses is followed, too.
    seed : int
        Of the random numbers.
    """

    bounces: int
    samples: int
    caustics: bool
    seed: int

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        merging = {"merging_radius": MERGING_RADIUS} if self.caustics else {}
        return asdict(self) | merging
