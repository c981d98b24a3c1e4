"""What the stages of one acquisition follow: its settings and its method's state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rfpipe.blocks import RayDomain
from rfpipe.methods import Method, Pack, get_method, options_of
from rfpipe.stages.folder import AcquisitionFolder

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["Plan", "plan_of"]


class Plan:
    """What an acquisition's stages know of it: its method, with its options, and its rays.

    Parameters
    ----------
    name : str
        What the settings' section and the results' folder are called.
    method : str
        A method's name or path, see `rfpipe.methods.get_method`.
    camera_shape, projector_shape : sequence of int
        See `rfpipe.blocks.RayDomain`.
    channels : int
        Colour channels, 1 or 3.
    options : mapping
        The method's.

    Raises
    ------
    InputError
        When there is no such method, or it lacks an option.
    """

    def __init__(
        self,
        name: str,
        method: str,
        camera_shape: Sequence[int],
        projector_shape: Sequence[int],
        channels: int,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.name = name
        named = get_method(method)
        self.camera = RayDomain(tuple(camera_shape))
        self.projector = RayDomain(tuple(projector_shape))
        self.channels = channels
        self.options = options_of(named, **(options or {}))
        self.method: Method[Any] = named.with_options(self.options)
        self._carried: tuple[int, Any] | None = None
        self._restored: tuple[list[str], Any] | None = None

    @property
    def n_levels(self) -> int:
        """Number of levels; raises InputError where the method doesn't fit the rays."""
        return self.method.n_levels(self.camera, self.projector)

    @property
    def asks_symmetry(self) -> bool:
        """Whether it has to be known if the rig is coaxial."""
        return self.method.asks_symmetry(self.camera, self.projector)

    def settle(self, method: Method[Any]) -> None:
        """Go on by the method that a choice has come to, which takes the same options."""
        self.method = method.with_options(self.options)
        self._carried = self._restored = None

    def carry(self, level: int, state: Any) -> None:
        """Keep the method's state before a level for `state_before`; None for one to restore."""
        self._carried = None if state is None else (level, state)
        self._restored = None

    def state_before(self, folder: AcquisitionFolder, level: int) -> Any:
        """Return the method's state before a level: carried from the one above, or what all left.

        It is restored once, and of what levels left only that is read which the state consists of.

        Raises
        ------
        StoreError, IntegrityError
            When a level's refinement is missing or damaged.
        """
        if self._carried and self._carried[0] == level:
            return self._carried[1]
        refined = [str(folder.path), *folder.refined_above(level)]
        if self._restored is None or self._restored[0] != refined:
            packs = []
            for above in range(level):
                arrays, attributes = folder.open(above, "refine")
                packs.append(Pack(arrays, attributes["state"]))
            start = self.method.start(self.camera, self.projector, self.channels, self.options)
            self._restored = refined, self.method.restore(start, packs)
        return self._restored[1]

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints."""
        return {
            "name": self.name,
            "method": self.method.name,
            "camera_shape": list(self.camera.shape),
            "projector_shape": list(self.projector.shape),
            "channels": self.channels,
            "options": self.options.options(),
        }


def plan_of(settings: Config, scene: str, name: str) -> dict[str, Any]:
    """Return the arguments of one of a run's plans as plain data."""
    section, about = settings.methods_of(scene)[name], settings.scenes[scene]
    return {
        "name": name,
        "method": section.method or name,
        "camera_shape": list(about.camera_ray_shape),
        "projector_shape": list(about.ray_shape),
        "channels": about.channels,
        "options": section.options(),
    }
