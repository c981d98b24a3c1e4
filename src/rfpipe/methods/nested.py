"""A method inside another one, where its levels have other numbers, its packs parts of others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic

from rfpipe.methods.base import Float, LevelImages, Method, Pack, State
from rfpipe.methods.images import FloodlitImage, renumbered
from rfpipe.methods.states import unprefixed
from rfpipe.patterns import Schedule

__all__ = ["Nested"]


@dataclass(frozen=True)
class Nested(Generic[State]):
    """A method inside another one.

    Attributes
    ----------
    method : Method
        The inner one.
    name : str
        The attribute of the outer one's packs that has the attributes of the inner one's; and,
        with a _ behind it, what the names of their arrays begin with.
    """

    method: Method[State]
    name: str

    def begun(self, start: Any, floodlit: Float, variance: Float) -> State:
        """Return the state after the floodlit image, which is there already, (C, pixels)."""
        image = FloodlitImage.of(start.camera, start.projector, floodlit, variance)
        return self.method.refine(start, image)

    def schedule(self, state: State, level: int) -> Schedule:
        """Return the next patterns under the outer method's number of their level."""
        return replace(self.method.schedule(state), level=level)

    def refine(self, state: Any, images: LevelImages, memory_bytes: int) -> State:
        """Refine a level."""
        return self.method.refine(state, renumbered(images, state.level), memory_bytes)

    def packed(self, state: State, **more: Any) -> Pack:
        """Return what the inner method packs, and more attributes, as part of a pack."""
        pack = self.method.pack(state)
        arrays = {f"{self.name}_{name}": array for name, array in pack.arrays.items()}
        return Pack(arrays, {self.name: {**pack.attributes, **more}})

    def packs_in(self, packs: Sequence[Pack]) -> list[Pack]:
        """Return the inner method's packs, of those levels that have any."""
        return [
            Pack(unprefixed(f"{self.name}_", pack.arrays), pack.attributes[self.name])
            for pack in packs
            if self.name in pack.attributes
        ]

    def restored(
        self, packs: Sequence[Pack], start: Callable[[Mapping[str, Any]], State]
    ) -> State | None:
        """Return the state after the last of packs, None where none has any of the inner method's.

        `start` makes the state before them of the attributes of the first.
        """
        own = self.packs_in(packs)
        return self.method.restore(start(own[0].attributes), own) if own else None
