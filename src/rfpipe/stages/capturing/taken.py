"""Acquisitions that are there: what they took, for the forecast of others."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import exp, log, prod
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, StoreError
from rfpipe.stages.plan import Plan
from rfpipe.store import read_manifest

__all__ = ["Taken", "proportion", "taken_in"]

# Rays to which an acquisition's patterns tell something of another's.
_LIKE = 16.0


@dataclass(frozen=True)
class Taken:
    """What a finished acquisition took.

    Attributes
    ----------
    scene, name : str
        Name of the scene, and of the method's section.
    method : str
        What it was acquired by.
    camera_shape, projector_shape : tuple of int
    channels : int
    options : dict
        The method's.
    patterns : int
    capture_seconds, seconds : float or None
        Of the captures, and of all stages; None where that isn't known.
    """

    scene: str
    name: str
    method: str
    camera_shape: tuple[int, ...]
    projector_shape: tuple[int, ...]
    channels: int
    options: dict[str, Any]
    patterns: int
    capture_seconds: float | None
    seconds: float | None

    def is_near(self, plan: Plan, factor: float) -> bool:
        """Whether it has as many rays as a plan, to a factor."""
        share = prod(self.projector_shape) / plan.projector.size
        return 1 / factor <= share <= factor

    def is_of(self, scene: str, plan: Plan) -> bool:
        """Whether it is the acquisition of a scene by a plan."""
        return self.scene == scene and self.name == plan.name and self._settings == (
            plan.camera.shape, plan.projector.shape, plan.channels, plan.options.options(),
        )  # fmt: skip

    @property
    def seconds_a_sample(self) -> float | None:
        """Seconds for each pattern and ray, of a simulated rig with all processing."""
        samples = self.patterns * prod(self.camera_shape) * self.channels
        return None if self.seconds is None or not samples else self.seconds / samples

    @property
    def _settings(self) -> tuple[Any, ...]:
        return self.camera_shape, self.projector_shape, self.channels, self.options


def taken_in(results: Path) -> list[Taken]:
    """Return the finished acquisitions of a results' folder; damaged ones are left out."""
    found = []
    for manifest in sorted(results.glob("*/*/transport.json")):
        try:
            facts = read_manifest(manifest)
            found.append(_of(facts, manifest.parent))
        except (StoreError, KeyError):
            continue
    return found


def proportion(taken: Iterable[Taken], plan: Plan) -> float | None:
    """Return how many patterns others by a plan's method took for each that was expected of them.

    None where there are no others of a like size.
    """
    logs = []
    for one in taken:
        if plan.method.name != one.method or not one.is_near(plan, _LIKE):
            continue
        try:
            of_it = Plan(
                one.name, one.method, one.camera_shape, one.projector_shape, one.channels,
                one.options,
            )  # fmt: skip
            expected = of_it.method.expected_patterns(of_it.camera, of_it.projector, of_it.options)
        except InputError:
            continue
        if one.patterns and expected:
            logs.append(log(one.patterns / expected))
    return exp(sum(logs) / len(logs)) if logs else None


def _of(facts: dict[str, Any], folder: Path) -> Taken:
    captures = [_seconds(path) for path in folder.glob("L*/capture.benchmark.tsv")]
    stages = [_seconds(path) for path in folder.glob("L*/*.benchmark.tsv")]
    return Taken(
        facts["scene"], facts["method"], facts["acquired_by"],
        tuple(facts["camera_shape"]), tuple(facts["projector_shape"]), facts["channels"],
        facts["options"], facts["patterns"],
        sum(captures) if captures else None, sum(stages) if stages else None,
    )  # fmt: skip


def _seconds(path: Path) -> float:
    """Return the seconds that a stage took, 0 where its record isn't one."""
    try:
        return float(path.read_text(encoding="ascii").splitlines()[1].split("\t")[0])
    except (OSError, ValueError, IndexError):
        return 0.0
