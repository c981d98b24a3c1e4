"""Simulated rigs: of a known matrix or linear operator, or of a simulated scene."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import ray_shape
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import ExactSensor, Sensor, sensor_from_config
from rfpipe.rigs.base import Key, check_patterns
from rfpipe.transport.operators import Transportish, as_pattern_operator

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig
    from rfpipe.scenes import Scene


class OperatorRig:
    """A simulated projector and camera with known light transport ``T``: ``c = T p`` (2.11).

    Parameters
    ----------
    matrix : array, sparse matrix, LinearOperator, list of those, or PatternOperator
        Shape (M, N), M camera rays and N projector rays in row-major order; (C, M, N) or a list
        for C channels; or an object with ``apply(patterns (B, N)) -> (B, M, C)`` and
        ``channels``. Entries are finite and not negative. Matrices are stored as float64.
    camera_shape, projector_shape : tuple of int
        Shapes of the domains of M and N rays, see `RayDomain`.
    noise : None, Sensor or CameraConfig
        None captures exact radiance; otherwise the camera of thesis appendix B.
    seed : int
        Seed of the noise, at least 0.
    seconds_per_pattern : float
        Seconds that a real rig would take for a bracket; the simulation doesn't wait.
    threads : int
        Number of threads that draw the noise of a batch; frames don't depend on it.

    Raises
    ------
    InputError
        When the matrix, its shape or a setting is wrong.
    """

    is_simulated = True

    def __init__(
        self,
        matrix: Transportish,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        noise: Sensor | CameraConfig | None = None,
        seed: int = 0,
        seconds_per_pattern: float = 2.0,
        threads: int = 1,
    ) -> None:
        self.camera_shape = ray_shape(camera_shape, "camera_shape")
        self.projector_shape = ray_shape(projector_shape, "projector_shape")
        self._operator = as_pattern_operator(
            matrix, prod(self.camera_shape), prod(self.projector_shape)
        )
        self.channels = int(self._operator.channels)
        if self.channels not in (1, 3):
            raise InputError(f"the transport has {self.channels} channels; expected 1 or 3")
        if seed < 0:
            raise InputError(f"seed is {seed}; expected an integer of at least 0")
        self.seed = int(seed)
        self.sensor = _as_sensor(noise)
        self.seconds_per_pattern = float(seconds_per_pattern)
        self._threads = threads
        self._frame_shape = self.sensor.frame_shape(self.camera_shape, self.channels)

    def __repr__(self) -> str:
        shapes = f"camera {self.camera_shape}, projector {self.projector_shape}"
        return f"{type(self).__name__}({shapes}, channels {self.channels})"

    def capture(self, patterns: NDArray[np.float32], keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns and return their brackets; see `rfpipe.rigs.Rig.capture`."""
        patterns = check_patterns(patterns, keys, self.projector_shape)
        frames = np.empty((len(patterns), *self._frame_shape), self.sensor.frame_dtype)
        if not len(patterns):
            return frames
        images = np.asarray(self._operator.apply(patterns.reshape(len(patterns), -1)))
        expected = (len(patterns), prod(self.camera_shape), self.channels)
        if images.shape != expected:
            raise CaptureError(
                f"the operator returned images of shape {images.shape} for patterns "
                f"{tuple(keys[0])} to {tuple(keys[-1])}; expected {expected}"
            )

        def expose(index: int) -> None:
            radiance = images[index].reshape(*self.camera_shape, self.channels)
            frames[index] = self.sensor.expose(radiance, self.seed, tuple(keys[index]))

        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(expose, range(len(frames))))
        return frames

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""
        describe = getattr(self._operator, "describe", None)
        return {
            "kind": "operator",
            "operator": describe() if describe else type(self._operator).__name__,
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "channels": self.channels,
            "sensor": self.sensor.describe(),
            "seed": self.seed,
            "seconds_per_pattern": self.seconds_per_pattern,
        }


class SimulatedRig(OperatorRig):
    """A rig in front of a simulated scene, one of `rfpipe.scenes` or the user's own.

    `sensor` is the camera's sensor, None for exact radiance; other parameters as `OperatorRig`.
    """

    def __init__(
        self,
        scene: Scene,
        sensor: Sensor | None = None,
        seed: int = 0,
        seconds_per_pattern: float = 2.0,
        threads: int = 1,
    ) -> None:
        shapes = scene.camera_shape, scene.projector_shape
        super().__init__(scene, *shapes, sensor, seed, seconds_per_pattern, threads)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""
        described = super().describe()
        scene = described.pop("operator")
        return {**described, "kind": "simulated", "scene": scene}


def _as_sensor(noise: Sensor | CameraConfig | None) -> Sensor:
    if noise is None:
        return ExactSensor()
    from rfpipe.config import CameraConfig

    if isinstance(noise, CameraConfig):
        return sensor_from_config(noise)
    if not callable(getattr(noise, "expose", None)):
        raise InputError(
            f"noise is a {type(noise).__name__}; expected None, a Sensor such as CameraModel, or "
            "a CameraConfig"
        )
    return noise
