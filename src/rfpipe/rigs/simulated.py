"""The simulated rig: a projector and a camera before a simulated scene."""

from __future__ import annotations

from typing import Any, Protocol

from rfpipe.photometry import Sensor
from rfpipe.rigs.base import PatternOperator
from rfpipe.rigs.operator import OperatorRig

__all__ = ["LitScene", "SimulatedRig"]


class LitScene(PatternOperator, Protocol):
    """A scene's light transport between two ray domains."""

    @property
    def camera_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain, see `rfpipe.blocks.RayDomain`."""

    @property
    def projector_shape(self) -> tuple[int, ...]:
        """Shape of the projector's ray domain."""

    def describe(self) -> dict[str, Any]:
        """Plain data: all that shapes the transport."""


class SimulatedRig(OperatorRig):
    """A projector and a camera that look at a simulated scene.

    Parameters
    ----------
    scene : LitScene
        Such as one of `rfpipe.scenes`.
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
        scene: LitScene,
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
