"""Footprint acquisition: near/far acquisition for rigs that aren't coaxial.

Direct light and indirect light are found together from random patterns, as in near/far acquisition.
Here nothing says which projector pixels a camera pixel sees: that is found from the same pictures,
with no structured light. Where the model doesn't fit, dual photography follows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, ErrorOptions, LevelImages, Pack
from rfpipe.methods.dual import Dual
from rfpipe.methods.footprints import candidates, handover, rounds
from rfpipe.methods.footprints.state import ROUNDS, FootprintState, kind_of, most_of
from rfpipe.methods.held_out.rounds import HeldOutMethod
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.states import Packing, arrays_of, level_row, unprefixed
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport


class Footprints(HeldOutMethod[FootprintState]):
    """Footprint acquisition as a `Method`, for any rig.

    Rounds of random patterns are fitted until the estimate of the error, from pictures that no fit
    sees, is at most ``target_error``. Where the model doesn't fit, or more rounds don't help, dual
    photography follows, no finer than the target asks for. The held-out pictures decide what is
    returned, whenever that is asked, and how good it is.
    """

    name = "footprints"
    bytes_per_ray = 100_000
    title = "Footprint acquisition"
    colour = "#6a3d9a"
    marker = "p"
    trials = (0.05, 0.01, 0.005)
    packing = Packing(("level", "following", "unfit", "new", "new_held", "rows"))

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the floodlit level, all rounds, and the levels of dual photography."""
        self.check(camera, projector)
        return len(ROUNDS) + Dual().n_levels(camera, projector)

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: ErrorOptions) -> int:
        """Return those of a scene for which all blocks are lit one by one, after all rounds."""
        return most_of(projector.views) + handover.most_patterns(camera, projector)

    def expected_patterns(
        self, camera: RayDomain, projector: RayDomain, options: ErrorOptions
    ) -> int:
        """Return the patterns of all rounds: more views, more patterns."""
        return min(projector.size, options.patterns or most_of(projector.views))

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> FootprintState:
        """Return the state before the floodlit image."""
        self.check(camera, projector)
        return FootprintState(camera, projector, channels, options)

    def schedule(self, state: FootprintState) -> Schedule:
        """Show the floodlit pattern, then rounds, held-out patterns before the others."""
        shape, level = state.projector.shape, state.level
        if level == 0:
            return Schedule.floodlit(shape)
        if state.kind != state.following:
            return Schedule.nothing(level, shape)
        if state.kind == "hierarchy":
            assert state.dual is not None
            return handover.DUAL.schedule(state.dual, level)
        return rounds.patterns(state)

    def asks(self, state: FootprintState) -> bool:
        """Tell whether the next level has patterns to show."""
        if state.dual is not None and state.kind == state.following == "hierarchy":
            return handover.DUAL.method.asks(state.dual)
        return super().asks(state)

    def refine(
        self, state: FootprintState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> FootprintState:
        """Fit all pictures so far, or refine the hierarchy, and estimate the error."""
        if state.level == 0:
            return rounds.begin(state, images)
        if state.kind != state.following:
            return state.after(level_row(state.level, 0), new=0, new_held=0)
        if state.kind == "hierarchy":
            return rounds.refine_hierarchy(state, images, memory_bytes)
        if not images.schedule.count:
            return state.after(level_row(state.level, 0), new=0, new_held=0, following="done")
        return rounds.decide(rounds.judge(rounds.refine(state, images)))

    def transport(self, state: FootprintState) -> Transport:
        """Return what predicts the held-out pictures best: the model, or the hierarchy."""
        return rounds.best(state)[0]

    def known(self, state: FootprintState) -> Transport:
        """Return the hierarchy while it is refined, however far off it still is."""
        if state.following != "hierarchy" or state.dual is None:
            return self.transport(state)
        return Dual().transport(state.dual)

    def pack(self, state: FootprintState) -> Pack:
        """Return the last level's pictures, and what was made of them."""
        assert state.pictures is not None
        own, just = super().pack(state), kind_of(state.level - 1)
        arrays: dict[str, NDArray[Any]] = {}
        if just == "floodlit":
            arrays |= arrays_of(state.pictures)
        elif state.new:
            assert state.model is not None
            arrays |= state.pictures.latest(state.new)
            arrays |= {f"model_{name}": array for name, array in state.model.items()}
            arrays |= arrays_of(state.found, "found_")
        own |= Pack(arrays, {})
        if state.dual is not None and (just == "hierarchy" or _begun(state)):
            own |= handover.packed(state.dual)
        return own

    def _restored(self, start: FootprintState, packs: Sequence[Pack]) -> FootprintState:
        own = [pack.arrays for pack in packs]
        fitted = [arrays for arrays in own if "found_keys" in arrays]
        return replace(
            super()._restored(start, packs),
            pictures=Pictures.restored(packs),
            model=dict(unprefixed("model_", fitted[-1])) if fitted else None,
            found=candidates.Footprints(**unprefixed("found_", fitted[-1])) if fitted else None,
            dual=handover.restored(start, packs),
        )


def _begun(state: FootprintState) -> bool:
    """Tell whether the last level was the round after which dual photography took over."""
    return state.following == "hierarchy" and bool(state.rows[-1]["patterns"])
