"""The rig protocol: patterns in, brackets out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.photometry.sensor import Sensor
from rfpipe.units import picture_name
from rfpipe.weights import as_weights

Float = NDArray[np.float32]
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
        """Seconds that a real rig takes for a bracket; simulations don't wait."""

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns and return their brackets.

        Parameters
        ----------
        patterns : ndarray of float32, shape (B, *projector_shape)
            Weights in [0, 1].
        keys : sequence of B tuples of int
            (level, index) of each pattern; with the rig's seed, all that its noise depends on.

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
        """Plain data for fingerprints and manifests: all that shapes a frame."""


def sequence_patterns(rig: Rig) -> int:
    """Return the most patterns that a rig shows in a sequence by hardware, 0 where it shows none.

    A rig that does has this number as its attribute `sequence_patterns`, and
    ``show_sequence(patterns, keys)``: as `Rig.capture`; what the hardware lost or mixed up is taken
    again.
    """
    return int(getattr(rig, "sequence_patterns", 0))


def is_simulated(rig: Rig) -> bool:
    """Test whether a rig is computed rather than built of devices.

    A simulated rig has the attribute `is_simulated`, True. All others may move, and their lamps may
    change: they are watched and verified by default, see `rfpipe.config.capture.PRECAUTIONS`.
    """
    return bool(getattr(rig, "is_simulated", False))


def capture_batch(rig: Rig, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
    """Return the brackets of patterns, by hardware where the rig does so; see `Rig.capture`."""
    capture: Any = rig.capture
    if len(patterns) > 1 and sequence_patterns(rig):
        capture = rig.show_sequence  # type: ignore[attr-defined]
    frames: NDArray[Any] = capture(patterns, keys)
    return frames


def check_patterns(
    patterns: NDArray[Any], keys: Sequence[Key], projector_shape: tuple[int, ...]
) -> Float:
    """Return patterns as float32, or raise InputError where a rig can't show them."""
    patterns = np.asarray(patterns)
    if patterns.shape[1:] != projector_shape or patterns.ndim != len(projector_shape) + 1:
        raise InputError(
            f"patterns have the shape {patterns.shape}; this projector shows (patterns, "
            f"{', '.join(map(str, projector_shape))})"
        )
    if len(keys) != len(patterns):
        raise InputError(f"{len(patterns)} patterns came with {len(keys)} keys; one key each")
    return check_weights(patterns, "the batch of patterns", [picture_name(key) for key in keys])


def check_weights(weights: NDArray[Any], what: str, names: Sequence[str]) -> Float:
    """Return pictures (n, ...) as float32; InputError names the first that leaves [0, 1]."""
    weights = as_weights(weights, what)
    is_right = (weights >= 0) & (weights <= 1)  # NaN is neither
    if not is_right.all():
        first, *pixel = (int(i) for i in np.argwhere(~is_right)[0])
        raise InputError(
            f"{names[first]} is {weights[(first, *pixel)]} at projector pixel {tuple(pixel)}; a "
            "projector shows weights from 0 to 1"
        )
    return np.asarray(weights, np.float32)
