"""Near/far acquisition: transport by range, from few pictures, with a live error estimate.

Direct light, near-range and far-range indirect light (S. K. Nayar et al., *Fast separation of
direct and global components*, SIGGRAPH 2006, for the first step) are found together from random
patterns. What that model leaves is found from all pictures together (`rfpipe.methods.residual`),
and where light is thrown to single places, symmetric photography comes before that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.base import MEMORY_BYTES, ErrorOptions, LevelImages, Pack
from rfpipe.methods.held_out.rounds import HeldOutMethod, gathered, latest
from rfpipe.methods.near_far import handover, rounds
from rfpipe.methods.near_far.model import Model
from rfpipe.methods.near_far.pictures import Pictures
from rfpipe.methods.near_far.state import BLOCKS, MOST, ROUNDS, NearFarState, kind_of
from rfpipe.methods.residual.estimate import Residual
from rfpipe.methods.residual.pictures import CellPictures
from rfpipe.methods.states import Packing, arrays_of, level_row, unprefixed
from rfpipe.methods.symmetric.method import Symmetric
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport
from rfpipe.transport.multiscale.basis import MultiscaleBasis


class NearFar(HeldOutMethod[NearFarState]):
    """Near/far acquisition as a `Method`.

    Rounds of random patterns are fitted until the estimate of the error, from pictures that no fit
    sees, is at most ``target_error``. Where smooth light isn't all there is, rounds of random
    blocks tell what it leaves; where light goes to single places, symmetric photography makes a
    hierarchy first, no finer than the target asks for. The held-out pictures decide what is
    returned, whenever that is asked, and how good it is.
    """

    name = "near_far"
    title = "Near/far acquisition"
    colour = "#b3263a"
    marker = "D"
    needs_coaxial_rig = True
    bytes_per_ray = 10_000
    trials = (0.05, 0.01, 0.003)
    most = MOST
    packing = Packing(("level", "following", "new", "new_held", "of_hierarchy", "rows"))

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the floodlit level, all rounds, and the levels of symmetric photography."""
        self.check(camera, projector)
        hierarchy = Symmetric().n_levels(camera, projector)
        return len(ROUNDS) + 2 * len(BLOCKS) + hierarchy

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: ErrorOptions) -> int:
        """Return those of a scene in which no block is of low rank, after all rounds."""
        return MOST + sum(BLOCKS) + Symmetric().most_patterns(camera, projector, options)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: ErrorOptions
    ) -> NearFarState:
        """Return the state before the floodlit image."""
        self.check(camera, projector)
        hierarchy = Symmetric().n_levels(camera, projector)
        return NearFarState(camera, projector, channels, options, hierarchy)

    def schedule(self, state: NearFarState) -> Schedule:
        """Show the floodlit pattern, then probes, held-out patterns before them."""
        shape, level = state.projector.shape, state.level
        if level == 0:
            return Schedule.floodlit(shape)
        if state.kind != state.following:
            return Schedule.nothing(level, shape)
        if state.kind == "hierarchy":
            assert state.symmetric is not None
            return handover.SYMMETRIC.schedule(state.symmetric, level)
        return rounds.patterns(state)

    def asks(self, state: NearFarState) -> bool:
        """Tell whether the next level has patterns to show."""
        if state.symmetric is not None and state.kind == state.following == "hierarchy":
            return handover.SYMMETRIC.method.asks(state.symmetric)
        return super().asks(state)

    def refine(
        self, state: NearFarState, images: LevelImages, memory_bytes: int = MEMORY_BYTES
    ) -> NearFarState:
        """Fit all pictures so far, or refine the hierarchy, and estimate the error."""
        if state.level == 0:
            return rounds.begin(state, images)
        if state.kind != state.following:
            return state.after(level_row(state.level, 0, rank_k=0), new=0, new_held=0)
        if state.kind == "hierarchy":
            return rounds.refine_hierarchy(state, images, memory_bytes)
        if not images.schedule.count:
            nothing = level_row(state.level, 0, rank_k=0)
            return state.after(nothing, new=0, new_held=0, following="done")
        fit = rounds.smooth if state.kind == "smooth" else rounds.beyond
        return rounds.decide(rounds.judge(fit(state, images)))

    def transport(self, state: NearFarState) -> Transport:
        """Return what predicts the held-out pictures best.

        Direct, near-range and far-range light as parts of a sum, or the hierarchy; and what either
        leaves.
        """
        return rounds.best(state)[0]

    def known(self, state: NearFarState) -> Transport:
        """Return the hierarchy while it is refined, however far off it still is."""
        if state.following != "hierarchy" or state.symmetric is None:
            return self.transport(state)
        return Symmetric().transport(state.symmetric)

    def pack(self, state: NearFarState) -> Pack:
        """Return the last level's pictures, and what was made of them."""
        assert state.pictures is not None
        own, just = super().pack(state), kind_of(state.level - 1, state.hierarchy)
        arrays: dict[str, NDArray[Any]] = {}
        if just == "floodlit":
            arrays |= arrays_of(state.pictures)
        elif just == "smooth" and state.new:
            assert state.model is not None
            arrays |= state.pictures.latest(state.new)
            arrays |= {"functions": state.model.basis.functions, "cores": state.model.cores}
        elif state.new:
            assert state.taken is not None
            arrays |= latest(state.taken, state.new, "taken_")
        if state.residual is not None and state.new and just != "hierarchy":
            arrays |= arrays_of(state.residual, "residual_")
        own |= Pack(arrays, {"leaves": state.residual is not None})
        if state.symmetric is not None and "hierarchy" in (just, state.following):
            own |= handover.SYMMETRIC.packed(state.symmetric)
        return own

    def _restored(self, start: NearFarState, packs: Sequence[Pack]) -> NearFarState:
        own = [pack.arrays for pack in packs]
        model = None
        if fitted := [arrays for arrays in own if "cores" in arrays]:
            basis = MultiscaleBasis(start.projector.shape, fitted[-1]["functions"])
            model = Model(basis, fitted[-1]["cores"])
        left = [found for arrays in own if (found := unprefixed("residual_", arrays))]
        return replace(
            super()._restored(start, packs),
            pictures=Pictures.restored(packs),
            taken=gathered(CellPictures, packs, "taken_"),
            model=model,
            residual=Residual(**left[-1]) if packs[-1].attributes["leaves"] else None,
            symmetric=handover.restored(start.projector, start.channels, start.options, packs),
        )
