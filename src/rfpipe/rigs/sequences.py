"""Sequences: lists of patterns that a rig shows and exposes in hardware, one a camera trigger."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs.base import Key, Rig
from rfpipe.rigs.devices import Camera, Projector

__all__ = [
    "SequenceCamera",
    "SequencePlayer",
    "SequenceProjector",
    "SequenceRig",
    "can_play",
    "capture_batch",
    "sequence_patterns",
]

Float = NDArray[np.float32]


class SequenceProjector(Projector, Protocol):
    """A projector that shows a list of pictures by its own clock, and triggers a camera at each.

    One whose sequences are of zeros and ones alone says so by ``sequence_levels = 2``.
    """

    @property
    def sequence_pictures(self) -> int:
        """The most pictures that it holds; 0 where it holds none as it is set up."""

    def load(self, pictures: Iterable[Float]) -> None:
        """Take pictures (H, W), weights in [0, 1], in the place of those before.

        Raises
        ------
        InputError
            When a picture has the wrong shape, or a weight that can't be shown in a sequence.
        CaptureError
            When the projector fails.
        """

    def play(self, order: Sequence[int], seconds: float) -> None:
        """Show loaded pictures in this order, each for so long, and trigger the camera at each.

        Returns when the last one was shown.

        Raises
        ------
        CaptureError
            When the projector fails.
        """


class SequenceCamera(Camera, Protocol):
    """A camera that takes a frame at each trigger of a projector."""

    @property
    def can_be_triggered(self) -> bool:
        """Whether it is set up for that."""

    def seconds_between(self, exposure: float) -> float:
        """Return the least time from one trigger to the next at an exposure time in seconds."""

    def arm(self, exposure: float, count: int) -> None:
        """Wait for `count` triggers from now on, each of a frame of `exposure` seconds."""

    def collect(self) -> NDArray[Any]:
        """Return the frames since `arm` in the order that they came in, and wait for no more.

        There may be fewer than were armed for, where triggers were missed: of shape
        (n, *sensor.frame_shape(shape, channels)[1:]).
        """


class SequencePlayer(Protocol):
    """What plays lists of patterns for `rfpipe.rigs.sequencer.Sequencer`."""

    def load(self, patterns: Float, keys: Sequence[Key]) -> None:
        """Take patterns (N, *projector_shape), in the place of those before."""

    def play(self, order: Sequence[int], exposure: int) -> NDArray[Any]:
        """Show them in this order, and return the frames of the exposure of that number.

        There may be fewer frames than were asked for, old ones, and ones in another order.
        """


class SequenceRig(Rig, Protocol):
    """A rig that shows and exposes lists of patterns in hardware, too."""

    @property
    def sequence_patterns(self) -> int:
        """The most patterns of a list; 0 where it has no sequences as it is set up."""

    def show_sequence(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns by hardware and return their brackets; else as `Rig.capture`.

        What the hardware lost or mixed up is found, and taken again.
        """


def can_play(projector: Projector, camera: Camera) -> bool:
    """Whether two devices show and expose sequences together."""
    return bool(
        getattr(projector, "sequence_pictures", 0) and getattr(camera, "can_be_triggered", False)
    )


def sequence_patterns(rig: Rig) -> int:
    """Return the most patterns that a rig shows in a sequence, 0 where it shows none."""
    return int(getattr(rig, "sequence_patterns", 0))


def capture_batch(rig: Rig, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
    """Show patterns and return their brackets: by hardware where the rig does so, else one by one.

    See `Rig.capture`.
    """
    if len(patterns) > 1 and sequence_patterns(rig):
        frames: NDArray[Any] = rig.show_sequence(patterns, keys)  # type: ignore[attr-defined]
        return frames
    return rig.capture(patterns, keys)
