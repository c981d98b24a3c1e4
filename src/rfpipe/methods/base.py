"""The protocol that every acquisition method follows; free of any file or device."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

Float = NDArray[np.float32]

MEMORY_BYTES = 2**32
"""Memory that refining a level may take where nothing else is said: 4 GiB."""


class LevelState(Protocol):
    """What the states of all methods have in common."""

    @property
    def rows(self) -> Sequence[Mapping[str, Any]]:
        """The table of levels so far, as `Transport.level_rows` will have it."""


State = TypeVar("State", bound=LevelState)


@dataclass(frozen=True)
class Settings:
    """What a method needs to know of the user's wishes.

    Attributes
    ----------
    tolerance : float
        Error allowed in an image, as a fraction of the floodlit image's maximum; above 0.
    noise_significance : float
        How many standard deviations make a measured energy significant; at least 0.
    subtract_stored : bool
        Dual photography: whether to take the light stored at coarser levels off finer images.
        The thesis does not.
    target_error : float
        Methods that estimate their own error: the error at which they stop, relative to the norm
        of a relit image; above 0.
    patterns : int
        Methods that choose how many patterns they show: how many at most, the floodlit one
        included, at least 0; 0 leaves it to the method.
    """

    tolerance: float = 1e-3
    noise_significance: float = 3.0
    subtract_stored: bool = False
    target_error: float = 0.01
    patterns: int = 0


class LevelImages(Protocol):
    """The radiance images of one level, read a few patterns at a time."""

    @property
    def schedule(self) -> Schedule:
        """The patterns they were taken under."""

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance, each float32 ``(last - first, *camera_shape, C)``."""


@dataclass(frozen=True)
class Pack:
    """What one level's refinement adds to a state, as named arrays and plain data."""

    arrays: Mapping[str, NDArray[Any]]
    attributes: Mapping[str, Any]


class Method(Protocol[State]):
    """An acquisition method: a state machine from floodlit image to transport.

    A level is: `schedule`, the capture of its patterns by somebody else, `refine`. The levels of
    a run are known beforehand (`n_levels`); a level with nothing left to ask has an empty
    schedule and is refined with no images.
    """

    name: str

    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the number of levels; raises InputError if the method does not fit the rig."""

    def start(
        self, camera: RayDomain, projector: RayDomain, channels: int, settings: Settings
    ) -> State:
        """Return the state before the first level."""

    def schedule(self, state: State) -> Schedule:
        """Return the patterns of the next level."""

    def refine(self, state: State, images: LevelImages, memory_bytes: int = ...) -> State:
        """Return the state after a level's images.

        Parameters
        ----------
        state
        images : LevelImages
        memory_bytes : int
            Memory, in bytes, that the work may take beside the state itself, about. The result
            does not depend on it.
        """

    def transport(self, state: State) -> Transport:
        """Return what is known of the transport so far; nodes still open at their estimate."""

    def pack(self, state: State) -> Pack:
        """Return what the last refinement added, and what the next one needs."""

    def restore(self, start: State, packs: Sequence[Pack]) -> State:
        """Return the state after the last of the given levels' packs."""


def require_coaxial(method: str, camera: RayDomain, projector: RayDomain) -> None:
    """Raise InputError unless camera and projector share one ray domain."""
    if camera.shape != projector.shape:
        raise InputError(
            f"{method} needs a coaxial rig, whose camera and projector share one ray domain, but "
            f"the camera's is {camera.shape} and the projector's {projector.shape}; use dual "
            "photography, or resample the camera onto the projector's grid"
        )
