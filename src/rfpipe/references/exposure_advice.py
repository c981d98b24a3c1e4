"""Remedies of a floodlit image with too much or too little light, by the kind of rig."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class FloodlitFault(StrEnum):
    """Fault of a floodlit image."""

    BRIGHT = "bright"
    DARK = "dark"


class RigKind(StrEnum):
    """Kind of a rig, by the means that change its light."""

    DEVICES = "devices"
    OFFLINE = "offline"
    SCENE = "scene"
    MATRIX = "matrix"
    PYTHON = "python"


_EXACT = "or set camera to null, for exact radiance"

REMEDIES: dict[FloodlitFault, dict[RigKind, str]] = {
    FloodlitFault.BRIGHT: {
        RigKind.DEVICES: "Add a shorter exposure, close the aperture, or dim the projector",
        RigKind.OFFLINE: "Add a shorter exposure to camera.exposures, close the aperture, or dim "
        "the projector, and take the pictures again",
        RigKind.SCENE: "Add a shorter exposure to camera.exposures, lower "
        f"camera.electrons_per_radiance, {_EXACT}",
        RigKind.MATRIX: "Set the scene's brightest, the largest radiance under floodlight, to 1, "
        f"add a shorter exposure to camera.exposures, {_EXACT}",
        RigKind.PYTHON: "Scale the matrix down, give the camera a shorter exposure, or take exact "
        "radiance (noise=None)",
    },
    FloodlitFault.DARK: {
        RigKind.DEVICES: "Check that the projector is on, that it lights the camera's field of "
        "view, and that the exposures are long enough",
        RigKind.OFFLINE: "Check that the projector was on, that it lit the camera's field of view, "
        "and that the exposures were long enough, and take the pictures again",
        RigKind.SCENE: "Check that the projector lights the camera's field of view, add a longer "
        f"exposure to camera.exposures, {_EXACT}",
        RigKind.MATRIX: "Set the scene's brightest, the largest radiance under floodlight, to 1, "
        f"add a longer exposure to camera.exposures, {_EXACT}",
        RigKind.PYTHON: "Check that the matrix isn't zero, scale it up, give the camera a longer "
        "exposure, or take exact radiance (noise=None)",
    },
}
"""Remedy of each fault for each kind of rig."""


def kind_of_rig(rig: Mapping[str, Any]) -> RigKind:
    """Return the kind of a rig by its description, see `rfpipe.rigs.Rig.describe`.

    The description of a simulated rig in memory is empty.
    """
    kind = rig.get("kind", "operator")
    if kind == "simulated":
        scene = rig.get("scene")
        is_matrix = isinstance(scene, Mapping) and scene.get("kind") == "matrix"
        return RigKind.MATRIX if is_matrix else RigKind.SCENE
    return {"operator": RigKind.PYTHON, "offline": RigKind.OFFLINE}.get(kind, RigKind.DEVICES)
