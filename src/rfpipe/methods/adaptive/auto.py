"""A method for any rig and scene, told one wish: the error of relit pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.method import Footprints
from rfpipe.methods.adaptive.near_far import NearFar
from rfpipe.methods.base import MEMORY_BYTES, ErrorOptions, LevelImages, Method, Pack
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport


class Auto(Method[Any]):
    """Near/far acquisition where the rig is coaxial, else, and of views, footprint acquisition.

    Either finds out while it goes whether light is smooth, or sparse and mirrored: that is for
    symmetric photography and for dual photography, to which they then hand over. Where nobody
    looks at the rig, it is taken for what the shapes of its rays allow.
    """

    name = "auto"
    title = "Automatic acquisition"
    colour = "#2a2a2a"
    marker = "h"
    estimates_error = True
    bytes_per_ray = 100_000
    Options = ErrorOptions
    trades = "target_error"
    trials = NearFar.trials

    def asks_symmetry(self, camera: RayDomain, projector: RayDomain) -> bool:
        """Ask of a rig whose rays may be shared; of views, footprints tell it themselves."""
        return camera.shape == projector.shape and projector.views == 1

    def on_rig(self, coaxial: bool) -> Method[Any]:
        """Return near/far acquisition, or footprint acquisition."""
        return NearFar() if coaxial else Footprints()

    def _likely(self, camera: RayDomain, projector: RayDomain) -> Method[Any]:
        return self.on_rig(self.asks_symmetry(camera, projector))

    def _of(self, state: Any) -> Method[Any]:
        return self._likely(state.camera, state.projector)

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return those of the method that the shapes allow."""
        return self._likely(camera, projector).n_levels(camera, projector)

    def expected_patterns(
        self, camera: RayDomain, projector: RayDomain, options: ErrorOptions
    ) -> int:
        """Guess the patterns, as the method that the shapes allow does."""
        return self._likely(camera, projector).expected_patterns(camera, projector, options)

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: ErrorOptions) -> int:
        """Return the largest number of the methods that the rig may turn out to need."""
        rigs = (True, False) if self.asks_symmetry(camera, projector) else (False,)
        return max(
            self.on_rig(coaxial).most_patterns(camera, projector, options) for coaxial in rigs
        )

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> Any:
        """Return the state before the floodlit image."""
        return self._likely(camera, projector).start(camera, projector, channels, options)

    def schedule(self, state: Any) -> Schedule:
        """Show the floodlit pattern, and what follows where nobody looks at the rig."""
        return self._of(state).schedule(state)

    def asks(self, state: Any) -> bool:
        """Tell whether the next level has patterns to show."""
        return self._of(state).asks(state)

    def refine(self, state: Any, images: LevelImages, memory_bytes: int = MEMORY_BYTES) -> Any:
        """Go on where nobody looks at the rig."""
        return self._of(state).refine(state, images, memory_bytes)

    def transport(self, state: Any) -> Transport:
        """Return what is known so far."""
        return self._of(state).transport(state)

    def known(self, state: Any) -> Transport:
        """Return what tells the light of rays that the next level leaves dark."""
        return self._of(state).known(state)

    def pack(self, state: Any) -> Pack:
        """Return what the last refinement added."""
        return self._of(state).pack(state)

    def restore(self, start: Any, packs: Sequence[Pack]) -> Any:
        """Return the state after the last of the given levels' packs."""
        return self._of(start).restore(start, packs)
