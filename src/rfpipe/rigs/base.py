"""The rig protocol: patterns in, brackets out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.errors import InputError
from rfpipe.photometry.sensor import Sensor
from rfpipe.units import picture_name
from rfpipe.weights import as_weights

Key = tuple[int, ...]


class Rig(Protocol):
    """A projector and a camera, real or simulated; see `rfpipe.testing.RigContract`."""

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain, see `rfpipe.blocks.RayDomain`."""

    @property
    def projector_shape(self) -> tuple[int, ...]:
        """Shape of the projector's ray domain."""

    @property
    def channels(self) -> int:
        """Colour channels, 1 or 3."""

    @property
    def sensor(self) -> Sensor:
        """The camera's sensor, which merges what `capture` returns."""

    @property
    def seconds_per_pattern(self) -> float:
        """Seconds that a real rig takes for a bracket; a simulation doesn't wait."""

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns and return their brackets.

        Parameters
        ----------
        patterns : ndarray of float32, shape (B, *projector_shape)
            Weights in [0, 1].
        keys : sequence of B tuples of int
            (level, index) of each pattern. Simulated noise depends on key and seed only.

        Returns
        -------
        ndarray of sensor.frame_dtype, shape (B, *sensor.frame_shape(camera_shape, channels))

        Raises
        ------
        InputError
            When patterns or keys have the wrong shape or range.
        CaptureError
            When the rig fails or the light is not finite.
        """

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""


def sequence_patterns(rig: Rig) -> int:
    """Largest number of patterns that a rig shows in a hardware sequence, 0 without sequences.

    A rig with sequences has this number as its attribute `sequence_patterns`, and a method
    ``show_sequence(patterns, keys)`` like `Rig.capture`, which repeats lost or misplaced frames.
    """
    return int(getattr(rig, "sequence_patterns", 0))


def is_simulated(rig: Rig) -> bool:
    """Test whether a rig is simulated: whether it has an attribute `is_simulated` that is True.

    Other rigs may move, and their lamps may change, so that by default check pictures and
    verification pictures are taken; see `rfpipe.config.capture.PRECAUTIONS`.
    """
    return bool(getattr(rig, "is_simulated", False))


def capture_batch(rig: Rig, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
    """Capture the brackets of patterns, by hardware sequences if the rig has them."""
    capture: Any = rig.capture
    if len(patterns) > 1 and sequence_patterns(rig):
        capture = rig.show_sequence  # type: ignore[attr-defined]
    frames: NDArray[Any] = capture(patterns, keys)
    return frames


def check_patterns(
    patterns: NDArray[Any], keys: Sequence[Key], projector_shape: tuple[int, ...]
) -> Float:
    """Convert patterns to float32; InputError if the projector can't show them."""
    patterns = np.asarray(patterns)
    if patterns.shape[1:] != projector_shape or patterns.ndim != len(projector_shape) + 1:
        raise InputError(
            f"the patterns have the shape {patterns.shape}; this projector needs (patterns, "
            f"{', '.join(map(str, projector_shape))})"
        )
    if len(keys) != len(patterns):
        raise InputError(
            f"{len(patterns)} patterns have {len(keys)} keys", remedy="give one key per pattern"
        )
    return check_weights(patterns, "the batch of patterns", [picture_name(key) for key in keys])


def check_weights(weights: NDArray[Any], what: str, names: Sequence[str]) -> Float:
    """Convert pictures (n, ...) to float32; InputError names the first weight outside [0, 1]."""
    weights = as_weights(weights, what)
    is_valid = (weights >= 0) & (weights <= 1)  # False for NaN
    if not is_valid.all():
        first, *pixel = (int(i) for i in np.argwhere(~is_valid)[0])
        raise InputError(
            f"{names[first]} is {weights[(first, *pixel)]} at projector pixel {tuple(pixel)}; a "
            "projector shows weights from 0 to 1"
        )
    return np.asarray(weights, np.float32)
