"""What every rig must do."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import ray_shape
from rfpipe.errors import InputError
from rfpipe.keys import BLACK_LEVEL_KEY
from rfpipe.photometry import MergeOptions
from rfpipe.provenance import generator
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch, sequence_patterns
from rfpipe.testing.checks import require, require_equal_descriptions, require_raises

Float = NDArray[np.float32]


class RigContract:
    """Tests that any rig must pass; subclass it as ``Test...`` and define `make_rig`.

    Attributes
    ----------
    repeatable : bool
        Whether two captures of one key give the same bytes, as a simulation's must. Set it to
        False for hardware, whose noise isn't ours to repeat.
    significance : float
        Standard deviations of the sum over an image by which light may miss what it should be.
    """

    repeatable: bool = True
    significance: float = 6.0

    def make_rig(self) -> Rig:
        """Return a rig, each time anew and each time the same; small, to be quick."""
        raise NotImplementedError(f"{type(self).__name__} must define make_rig()")

    @contextmanager
    def _opened(self) -> Iterator[Rig]:
        """Give a rig that can be closed back after its test."""
        rig = self.make_rig()
        with ExitStack() as stack:
            if hasattr(rig, "close"):
                stack.callback(rig.close)
            yield rig

    def test_shapes(self) -> None:
        """Shapes are those of ray domains, channels 1 or 3, exposures positive."""
        with self._opened() as rig:
            for name, shape in (("camera", rig.camera_shape), ("projector", rig.projector_shape)):
                ray_shape(shape, f"{name}_shape")
            require(rig.channels in (1, 3), f"channels is {rig.channels}, not 1 or 3")
            require(min(rig.sensor.exposures) > 0, f"exposures are {rig.sensor.exposures}")
            require(rig.seconds_per_pattern >= 0, "seconds_per_pattern is negative")

    def test_frames(self) -> None:
        """Frames have the sensor's shape and dtype, also for a batch of none."""
        with self._opened() as rig:
            shape = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
            for count in (0, 1, 3):
                frames = rig.capture(*_batch(rig, count))
                found, expected = (
                    (frames.shape, frames.dtype),
                    ((count, *shape), rig.sensor.frame_dtype),
                )
                require(found == expected, f"frames are {found}; expected {expected}")

    def test_same_bytes_however_captured(self) -> None:
        """A key's frames depend on no batch, order, or earlier capture; its noise is its own."""
        if not self.repeatable:
            return
        with self._opened() as rig:
            patterns, keys = _batch(rig, 7)
            frames = rig.capture(patterns, keys)
        with self._opened() as again:
            for first, last in ((5, 7), (0, 1), (1, 5)):
                part = again.capture(patterns[first:last], keys[first:last])
                same = np.array_equal(part, frames[first:last])
                require(same, f"patterns {first} to {last} differ when captured by themselves")
            backwards = again.capture(patterns[::-1], keys[::-1])
            require(np.array_equal(backwards[::-1], frames), "frames differ in another order")
            pattern = np.ones((2, *again.projector_shape), np.float32)
            frames = again.capture(pattern, [(1, 0), (1, 1)])
            merged = again.sensor.merge(frames, _black(again)[0])
            if merged.variance.max() > 0 and merged.radiance[0].size > 1:
                require(not np.array_equal(*frames), "two keys got the same noise")

    def test_black_is_black(self) -> None:
        """An all-off bracket merges to no light, within its variance."""
        with self._opened() as rig:
            black, options = _black(rig)
            dark = np.zeros((1, *rig.projector_shape), np.float32)
            frames = rig.capture(dark, [(BLACK_LEVEL_KEY, options.black_count)])
            merged = rig.sensor.merge(frames, black, options)
            self._require_equal_light(merged.radiance[0], merged.variance[0], 0.0, "black")

    def test_light_adds_up(self) -> None:
        """Half of the rays and the other half together give what all rays give."""
        with self._opened() as rig:
            black, options = _black(rig)
            half = np.zeros(rig.projector_shape, np.float32)
            half.ravel()[::2] = 1
            patterns = np.stack([half, 1 - half, np.ones_like(half)])
            frames = rig.capture(patterns, [(2, index) for index in range(3)])
            merged = rig.sensor.merge(frames, black, options)
            require(np.isfinite(merged.radiance).all(), "merged radiance isn't finite")
            require((merged.variance >= 0).all(), "a variance is negative")
            require(not merged.saturated, "the floodlit pattern saturates: expose for less")
            parts, whole = merged.radiance[:2].sum(axis=0, dtype=np.float64), merged.radiance[2]
            self._require_equal_light(
                parts - whole, merged.variance.sum(axis=0), whole, "two halves"
            )

    def test_sequences_are_what_is_taken_one_by_one(self) -> None:
        """A rig that shows sequences in hardware returns the brackets of each pattern."""
        with self._opened() as rig:
            if not sequence_patterns(rig):
                return
            patterns, keys = _batch(rig, 6)
            patterns = np.rint(patterns)
            frames, one_by_one = capture_batch(rig, patterns, keys), rig.capture(patterns, keys)
            if self.repeatable:
                require(np.array_equal(frames, one_by_one), "a sequence gives other bytes")
            black, options = _black(rig)
            merged, expected = (
                rig.sensor.merge(taken, black, options) for taken in (frames, one_by_one)
            )
            difference = merged.radiance - expected.radiance
            variance = merged.variance + expected.variance
            for index, light in enumerate(expected.radiance):
                name = f"pattern {index} of a sequence"
                self._require_equal_light(difference[index], variance[index], light, name)

    def test_rejects_what_cannot_be_shown(self) -> None:
        """Wrong shapes, weights outside [0, 1], NaN, and missing keys raise InputError."""
        with self._opened() as rig:
            good = np.ones((1, *rig.projector_shape), np.float32)
            counts: NDArray[Any] = (255 * good).astype(np.uint8)
            wrong_shape = np.ones((1, *rig.projector_shape, 2), np.float32)
            for name, patterns, keys in (
                ("a wrong shape", wrong_shape, [(1, 0)]),
                ("a weight of 1.5", 1.5 * good, [(1, 0)]),
                ("a negative weight", -good, [(1, 0)]),
                ("NaN", np.nan * good, [(1, 0)]),
                ("a picture of 0 to 255", counts, [(1, 0)]),
                ("a pattern without key", good, []),
            ):
                capture = partial(rig.capture, patterns, keys)
                require_raises(InputError, capture, f"the rig took {name}")

    def test_describes_itself(self) -> None:
        """`describe` gives plain data, the same for equal rigs."""
        require_equal_descriptions(self._opened)

    def _require_equal_light(
        self, difference: NDArray[Any], variance: Float, scale: Float | float, name: str
    ) -> None:
        """Compare sums over the image, with room for the rounding of float32 and of counts."""
        rounding = float(np.finfo(np.float32).eps) * float(np.sum(scale, dtype=np.float64)) * 4
        error = float(np.sqrt(variance.sum(dtype=np.float64)))
        total = float(np.sum(difference, dtype=np.float64))
        require(
            abs(total) <= self.significance * error + rounding,
            f"{name}: light is off by {total:.4g} in all; noise {error:.4g}",
        )


def _batch(rig: Rig, count: int) -> tuple[Float, list[tuple[int, int]]]:
    """Return random patterns with keys of level 1."""
    weights = generator(0).random((count, prod(rig.projector_shape)), np.float32)
    return weights.reshape(count, *rig.projector_shape), [(1, index) for index in range(count)]


def _black(rig: Rig, count: int = 4) -> tuple[Float, MergeOptions]:
    """Return the mean of all-off brackets and the options that tell of how many."""
    patterns = np.zeros((count, *rig.projector_shape), np.float32)
    frames = rig.capture(patterns, [(BLACK_LEVEL_KEY, index) for index in range(count)])
    mean = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
    return mean, MergeOptions(black_count=count)
