"""A scene by dual photography: primal and dual pictures, in even light and by a matte."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from figures.common import (
    acquired,
    dual_truth,
    error,
    exposure,
    level_pictures,
    matte,
    percent,
    seen,
    white,
)
from rfpipe.array_types import Float
from rfpipe.report.drawing import Map, Panel, difference


@dataclass(frozen=True)
class Relit:
    """A scene acquired by dual photography; its pictures by their names, with the truth of each."""

    scene: Any
    result: Any
    pictures: dict[str, Float]
    truths: dict[str, Float]
    coarse: float  # fraction of the dual picture's light that is stored above the last level

    def error(self, name: str) -> float:
        """Return a picture's relative error."""
        return error(self.pictures[name], self.truths[name])

    def white(self, name: str) -> float:
        """Return the radiance to show as white in a picture."""
        return exposure(self.truths[name])

    def row(self, *names: str) -> list[Panel | Map | None]:
        """Return pictures, each with its truth, and the last one's error."""
        bright, row = self.white(names[0]), []
        for name in names:
            title = name.replace("_", ", by a ")
            below = f"error {percent(self.error(name))}"
            row.append(Panel(self.pictures[name], f"{title}, relit", below, bright))
            row.append(Panel(self.truths[name], "ground truth", "", bright))
        return [*row, difference(self.pictures[names[-1]], self.truths[names[-1]], bright)]


def relit(scene: Any) -> Relit:
    """Acquire a scene by dual photography, and relight it from both sides."""
    result, _ = acquired(scene, "dual")
    pictures, truths = {}, {}
    for suffix, pattern in (("", white), ("_matte", matte)):
        thrown, lit = pattern(scene.projector_shape), pattern(scene.camera_shape)
        pictures[f"primal{suffix}"] = result.transport.relight(thrown)
        truths[f"primal{suffix}"] = seen(scene, thrown)
        pictures[f"dual{suffix}"] = result.transport.T.relight(lit)
        truths[f"dual{suffix}"] = dual_truth(scene, lit)
    parts = level_pictures(result, white(scene.camera_shape))
    sums = [float(part.sum(dtype=float)) for part in parts]
    return Relit(scene, result, pictures, truths, 1 - sums[-1] / sum(sums))
