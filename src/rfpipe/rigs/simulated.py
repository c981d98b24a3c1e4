"""The simulated rig: a projector and a camera before a simulated scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rfpipe.photometry import Sensor
from rfpipe.rigs.operator import OperatorRig

if TYPE_CHECKING:
    from rfpipe.scenes import Scene

__all__ = ["SimulatedRig"]


class SimulatedRig(OperatorRig):
    """A projector and a camera that look at a simulated scene.

    Parameters
    ----------
    scene : Scene
        One of `rfpipe.scenes`, or your own.
    sensor : Sensor or None
        The camera; None captures exact radiance.
    seed : int
        Seed of the noise, at least 0.
    seconds_per_pattern : float
        Seconds that a real rig would take for a bracket; the simulation doesn't wait.
    threads : int
        Threads that draw the noise; the frames don't depend on it.
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
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        described = super().describe()
        scene = described.pop("operator")
        return {**described, "kind": "simulated", "scene": scene}
