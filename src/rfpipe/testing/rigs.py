"""Contract of rigs: tests that every rig must pass."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal, assert_equal
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import ray_shape
from rfpipe.errors import InputError
from rfpipe.provenance import generator
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch, sequence_patterns
from rfpipe.testing.checks import opened, require, require_equal_descriptions, require_raises
from rfpipe.units import BLACK_LEVEL_KEY


class RigContract:
    """Tests that any rig must pass.

    Subclass it as ``Test...`` and define `make_rig`.

    Attributes
    ----------
    repeatable : bool
        Whether two captures of one key give the same bytes, as a simulation must. Set it to False
        for hardware, whose noise can't be repeated.
    significance : float
        Largest error of the light of an image column, in standard deviations of its noise.
    """

    repeatable: bool = True
    significance: float = 6.0

    def make_rig(self) -> Rig:
        """Return a new, preferably small rig with the same settings at every call."""
        raise NotImplementedError(f"{type(self).__name__} must define make_rig()")

    def test_frames(self) -> None:
        """Frames have the shape and dtype of the sensor, also for an empty batch of patterns."""
        with opened(self.make_rig()) as rig:
            for name, shape in (("camera", rig.camera_shape), ("projector", rig.projector_shape)):
                ray_shape(shape, f"{name}_shape")
            require(rig.channels in (1, 3), f"channels is {rig.channels}, not 1 or 3")
            require(min(rig.sensor.exposures) > 0, f"exposures are {rig.sensor.exposures}")
            require(rig.seconds_per_pattern >= 0, "seconds_per_pattern is negative")
            shape = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
            for count in (0, 1, 3):
                frames = rig.capture(*_batch(rig, count))
                expected = (count, *shape), rig.sensor.frame_dtype
                assert_equal((frames.shape, frames.dtype), expected, "frames")

    def test_same_bytes_however_captured(self) -> None:
        """Frames depend on the pattern and its key, not on the batch, order or earlier captures."""
        if not self.repeatable:
            return
        with opened(self.make_rig()) as rig:
            patterns, keys = _batch(rig, 7)
            frames = rig.capture(patterns, keys)
        with opened(self.make_rig()) as second_rig:
            for first, last in ((5, 7), (0, 1), (1, 5)):
                part = second_rig.capture(patterns[first:last], keys[first:last])
                assert_array_equal(part, frames[first:last], "patterns captured in another batch")
            backwards = second_rig.capture(patterns[::-1], keys[::-1])
            assert_array_equal(backwards[::-1], frames, "frames in another order")
            frames = second_rig.capture(np.ones_like(patterns[:2]), keys[:2])
            merged = second_rig.sensor.merge(frames, _black(second_rig)[0])
            if merged.variance.max() > 0 and merged.radiance[0].size > 1:
                require(not np.array_equal(*frames), "two keys got the same noise")

    def test_light_adds_up(self) -> None:
        """Two halves of the rays give the light of all rays, and black gives none immediately.

        Each edge of the projector's picture must be visible in the scene. Hardware sequences must
        give the bracket of each pattern.
        """
        with opened(self.make_rig()) as rig:
            black, count = _black(rig)
            edges = np.zeros((4, *rig.projector_shape), np.float32)
            edges[0, ..., 0] = edges[1, ..., -1] = edges[2, ..., 0, :] = edges[3, ..., -1, :] = 1
            half = np.zeros(rig.projector_shape, np.float32)
            half.ravel()[::2] = 1
            patterns = np.stack([*edges, half, 1 - half, np.ones_like(half), np.zeros_like(half)])
            keys = [(2, index) for index in range(len(patterns))]
            frames = rig.capture(patterns, keys)
            merged = rig.sensor.merge(frames, black, count)
            light, variance = merged.radiance, merged.variance
            require(np.isfinite(light).all(), "merged radiance isn't finite")
            require((variance >= 0).all(), "a variance is negative")
            self._require_equal_light(light[7], variance[7], 0 * light[7], "black after white")
            require(not merged.saturated, "the floodlit pattern saturates: expose for less")
            sums, squares = (
                array.reshape(8, -1).sum(1, dtype=np.float64) for array in (light, variance)
            )
            is_visible = sums[:4] > self.significance * np.sqrt(squares[:4])
            require(is_visible.all(), f"light of the left, right, upper and lower edge: {sums[:4]}")
            parts, noise = light[4:6].sum(axis=0, dtype=np.float64), variance[4:7].sum(axis=0)
            self._require_equal_light(parts - light[6], noise, light[6], "halves")
            if sequence_patterns(rig):
                by_hardware = capture_batch(rig, patterns, keys)
                if self.repeatable:
                    assert_array_equal(by_hardware, frames, "a sequence's bytes")
                sequence = rig.sensor.merge(by_hardware, black, count)
                for index, off in enumerate(sequence.radiance - light):
                    noise, name = (
                        variance[index] + sequence.variance[index],
                        f"{index} of a sequence",
                    )
                    self._require_equal_light(off, noise, light[index], f"pattern {name}")

    def test_rejects_what_cannot_be_shown(self) -> None:
        """Wrong shapes, weights outside [0, 1], NaN, and missing keys raise InputError."""
        with opened(self.make_rig()) as rig:
            good = np.ones((1, *rig.projector_shape), np.float32)
            for wrong in (good[..., None], 1.5 * good, -good, np.nan * good, 255 * good):
                require_raises(InputError, rig.capture, wrong, [(1, 0)])
            require_raises(InputError, rig.capture, good, [])

    def test_describes_itself(self) -> None:
        """`describe` gives plain data, the same for equal rigs."""
        require_equal_descriptions(self.make_rig, lambda rig: rig.capture(*_batch(rig, 2)))

    def _require_equal_light(
        self, difference: NDArray[Any], variance: Float, scale: Float, name: str
    ) -> None:
        """Compare sums over columns, allowing for noise and for rounding of float32 and counts."""
        rows = tuple(range(difference.ndim - 2))
        total, square, brightness = (
            array.sum(axis=rows, dtype=np.float64) for array in (difference, variance, scale)
        )
        rounding = 4 * float(np.finfo(np.float32).eps) * brightness
        above = np.abs(total) - self.significance * np.sqrt(square) - rounding
        at = np.unravel_index(above.argmax(), above.shape)
        require(
            above[at] <= 0,
            f"{name}: light of column {at[0]}, channel {at[1]} is off by {total[at]:.4g} in all; "
            f"noise {np.sqrt(square[at]):.4g}",
        )


def _batch(rig: Rig, count: int) -> tuple[Float, list[tuple[int, int]]]:
    """Return random patterns with keys of level 1."""
    weights = generator(0).random((count, prod(rig.projector_shape)), np.float32)
    return weights.reshape(count, *rig.projector_shape), [(1, index) for index in range(count)]


def _black(rig: Rig, count: int = 4) -> tuple[Float, int]:
    """Return the mean all-off bracket and the number of brackets."""
    patterns = np.zeros((count, *rig.projector_shape), np.float32)
    frames = rig.capture(patterns, [(BLACK_LEVEL_KEY, index) for index in range(count)])
    mean = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
    return mean, count
