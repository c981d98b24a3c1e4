"""Remedies of pictures with too much or too little light, by the kind of rig that took them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any


class FloodlitFault(StrEnum):
    """A fault of the floodlit image."""

    BRIGHT = "bright"
    DARK = "dark"


class Kind(StrEnum):
    """A kind of rig, as far as its light is changed by other means."""

    DEVICES = "devices"
    OFFLINE = "offline"
    SCENE = "scene"
    MATRIX = "matrix"
    PYTHON = "python"


_EXACT = "or set camera to null, for exact radiance"

REMEDIES: dict[FloodlitFault, dict[Kind, str]] = {
    FloodlitFault.BRIGHT: {
        Kind.DEVICES: "Add a shorter exposure, close the aperture, or dim the projector",
        Kind.OFFLINE: "Add a shorter exposure to camera.exposures, close the aperture, or dim the "
        "projector, and take the pictures again",
        Kind.SCENE: "Add a shorter exposure to camera.exposures, lower "
        f"camera.electrons_per_radiance, {_EXACT}",
        Kind.MATRIX: "Set the scene's brightest, the largest radiance under floodlight, to 1, add "
        f"a shorter exposure to camera.exposures, {_EXACT}",
        Kind.PYTHON: "Scale the matrix down, give the camera a shorter exposure, or take exact "
        "radiance (noise=None)",
    },
    FloodlitFault.DARK: {
        Kind.DEVICES: "Check that the projector is on, that the camera sees what it lights, and "
        "that the exposures are long enough",
        Kind.OFFLINE: "Check that the projector was on, that the camera saw what it lit, and that "
        "the exposures were long enough, and take the pictures again",
        Kind.SCENE: "Check that the projector lights what the camera sees, add a longer exposure "
        f"to camera.exposures, {_EXACT}",
        Kind.MATRIX: "Set the scene's brightest, the largest radiance under floodlight, to 1, add "
        f"a longer exposure to camera.exposures, {_EXACT}",
        Kind.PYTHON: "Check that the matrix isn't zero, scale it up, give the camera a longer "
        "exposure, or take exact radiance (noise=None)",
    },
}
"""What to do about each fault before each kind of rig."""


def kind_of(rig: Mapping[str, Any]) -> Kind:
    """Return the kind of a rig by its description, see `rfpipe.rigs.Rig.describe`.

    A simulated rig in memory isn't described.
    """
    kind = rig.get("kind", "operator")
    if kind == "simulated":
        scene = rig.get("scene")
        is_matrix = isinstance(scene, Mapping) and scene.get("kind") == "matrix"
        return Kind.MATRIX if is_matrix else Kind.SCENE
    return {"operator": Kind.PYTHON, "offline": Kind.OFFLINE}.get(kind, Kind.DEVICES)
