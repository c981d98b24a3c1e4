"""Methods that go down a block tree, and their end at an error that held-out pictures tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.adaptive.estimate import HELD_OUT
from rfpipe.methods.adaptive.rounds import Adaptive, inner_packs, log_end
from rfpipe.methods.adaptive.state import AdaptiveState
from rfpipe.methods.base import (
    MEMORY_BYTES,
    LevelImages,
    Method,
    Pack,
    State,
    TargetOptions,
)
from rfpipe.methods.states import PackingMethod, level_row
from rfpipe.transport.base import Transport


class Descent(PackingMethod[State]):
    """A method that goes down the projector's block tree, from the floodlit root to its rays.

    `thesis_patterns` are those of a scene of the thesis at 310 x 350 rays, in ten levels.
    """

    trades = "tolerance"
    thesis_patterns: ClassVar[int]

    def with_options(self, options: Any) -> Method[Any]:
        """Return the method that ends at the error asked for, where one is."""
        return self if options.target_error is None else Targeted(self)

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the depth of the block tree."""
        self.check(camera, projector)
        return BlockTree(projector).n_levels

    def asks(self, state: Any) -> bool:
        """Tell whether blocks are left to subdivide, without colouring them."""
        return state.level == 0 or len(state.frontier) > 0

    def expected_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Guess the patterns from those of the thesis' scene, so many a level."""
        levels = self.n_levels(camera, projector)
        return min(projector.size, round(levels * self.thesis_patterns / 10))

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Return the patterns of a scene for which all blocks are lit one by one."""
        tree = BlockTree(projector)
        return sum(tree.n_blocks(level) for level in range(tree.n_levels))


@dataclass(frozen=True)
class TargetedState(AdaptiveState):
    """The state of a descent that ends at a target.

    Attributes
    ----------
    best : MethodState, optional
        The hierarchy's state whose transport predicts the held-out pictures best: of a level
        further up, where the levels below made it worse.
    best_level : int
        Its level.
    """

    following: str = "hierarchy"
    best: Any = None
    best_level: int = 0


class Targeted(Adaptive):
    """A method that goes down a block tree, until held-out pictures are predicted well enough.

    After the floodlit image come the held-out pictures, none of which the inner method is shown.
    """

    State = TargetedState

    def __init__(self, inner: Descent[Any]) -> None:
        self._inner = inner
        for name in set(Method.__annotations__) - {"estimates_error"}:
            setattr(self, name, getattr(inner, name))

    @property
    def hierarchy(self) -> Method[Any]:
        """The inner method."""
        return self._inner

    def levels(self, projector: RayDomain) -> tuple[tuple[str, int], ...]:
        """Return the tree's levels, and that of the held-out pictures."""
        return (("any", 0),) * (BlockTree(projector).n_levels)

    def expected_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Guess the patterns from those of the inner method."""
        return self._inner.expected_patterns(camera, projector, options) + len(HELD_OUT)

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Return the patterns of a scene for which all blocks are lit one by one."""
        return self._inner.most_patterns(camera, projector, options) + len(HELD_OUT)

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: TargetOptions
    ) -> AdaptiveState:
        """Return the state before the floodlit image; without a ``target_error`` it ends at none.

        The tolerance follows from the target: relit pictures are off by some three tolerances.
        """
        target: Any = options
        tolerance = target.tolerance
        if target.target_error is not None:
            default = type(target).model_fields["tolerance"].default
            follows = 0.3 * target.target_error
            tolerance = follows if tolerance == default else min(tolerance, follows)
        state = TargetedState(camera, projector, channels, options, tolerance=tolerance)
        begun = self._inner_start(state)
        return replace(state, inner=begun, best=begun)

    def slot(self, state: AdaptiveState, back: int = 0) -> tuple[str, int]:
        """Return what follows: no level is kept for anything else."""
        return state.following, 0

    def _row(self, state: AdaptiveState, patterns: int, **counts: int) -> dict[str, Any]:
        """Return the next level's row: ``block_level`` is that which the hierarchy has reached."""
        alike = dict.fromkeys(state.inner.rows[0], 0) if state.inner.rows else {}
        row = level_row(state.level, patterns, block_level=len(state.descended) - 1)
        return {**alike, **row}

    def _begun(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        taken = super()._begun(state, images).taken
        return self._descend(state, images, MEMORY_BYTES, taken=taken)

    def _descend(
        self, state: AdaptiveState, images: LevelImages, memory_bytes: int, **new: Any
    ) -> AdaptiveState:
        after = super()._descend(state, images, memory_bytes, **new)
        if isinstance(after, TargetedState) and not after.held:
            after = replace(after, best=after.inner).changed(best_level=after.inner.level)
        return self.decided(after)

    def _seen(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        """Keep no pictures: the inner method's transport is returned as it is."""
        return state

    def _candidates(self, state: AdaptiveState) -> Iterator[Transport]:
        """Yield the transport of the inner method's best state."""
        assert isinstance(state, TargetedState)
        transport = self.hierarchy.transport(state.best)
        transport.level_rows = list(state.rows)
        yield transport

    def _judged(self, state: AdaptiveState, before: AdaptiveState | None = None) -> AdaptiveState:
        """Take the inner method's transport for the best where it is no worse."""
        assert isinstance(state, TargetedState)
        states = [state.inner] if state.best is state.inner else [state.inner, state.best]
        estimates = [self._estimate(state, self.hierarchy.transport(each)) for each in states]
        estimate, best = min(zip(estimates, states, strict=True), key=lambda each: each[0].error)
        return replace(state, best=best).changed(best_level=best.level).estimated(estimate)

    def transport(self, state: AdaptiveState) -> Transport:
        """Return what predicts the held-out pictures best, of the inner method's kind."""
        return next(self._candidates(state))

    def decided(self, state: AdaptiveState) -> AdaptiveState:
        """Ask for the held-out pictures, go on down the tree, or end."""
        if not state.held:
            return state.changed(following="held")
        below = state.inner.level < BlockTree(state.projector).n_levels
        if not (state.reached or below):
            log_end(state, f"no blocks are left at a tolerance of {state.tolerance:.2g}")
        return state.changed(following="hierarchy" if below and not state.reached else "done")

    def known(self, state: AdaptiveState) -> Transport:
        """Return what the inner method goes on with."""
        return self.hierarchy.known(state.inner)

    def restore(self, start: AdaptiveState, packs: Sequence[Pack]) -> AdaptiveState:
        """Return the state after the last of `packs`, one a level from level 0 on."""
        state, inner = super().restore(start, packs), inner_packs(packs)
        assert isinstance(state, TargetedState)
        if state.best_level == state.inner.level:
            return replace(state, best=state.inner)
        best = self.hierarchy.restore(self._inner_start(state), inner[: state.best_level])
        return replace(state, best=best)
