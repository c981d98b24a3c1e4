"""A physically based scene as Mitsuba 3 describes it, apart from the rig that looks at it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.scenes.mitsuba.variant import load_mitsuba
from rfpipe.scenes.mitsuba.views import View

__all__ = ["World", "load_scene", "world_of_file"]

# What a rig brings along, or what asks for a renderer of another kind.
_LEFT_OUT = ("Emitter", "Sensor", "Integrator")


@dataclass(frozen=True)
class World:
    """A scene, the places of cameras and projectors before it, and the light that it needs.

    Attributes
    ----------
    name : str
    tests : str
        What the scene is there for.
    build : callable
        Returns the scene as a dict of Mitsuba's, in plain data: `to_world` as a list of four rows,
        `bitmap` as an array float32 (H, W, 3). Its sensors and emitters are left out.
    cameras : tuple of View
    projectors : tuple of View, or None
        None of a coaxial rig, whose projectors stand where its cameras stand.
    bounces : int
        Vertices of a path of light from projector to camera that are worth following.
    caustics : bool
        Whether mirrors or lenses throw light on surfaces, which is followed from the projector.
    """

    name: str
    tests: str
    build: Callable[[], dict[str, Any]]
    cameras: tuple[View, ...]
    projectors: tuple[View, ...] | None = None
    bounces: int = 6
    caustics: bool = False

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints: the scene alone."""
        return {"name": self.name, "digest": fingerprint(self.build())}


def world_of_file(path: Path) -> World:
    """Return the scene of a file: XML of Mitsuba's, or JSON of a dict of its.

    Its first perspective sensor is the camera, its first emitter of type projector the projector;
    without one the rig is coaxial.

    Raises
    ------
    InputError
        When the file can't be read or is no scene, or has no perspective sensor.
    """
    mi = load_mitsuba()
    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".json":
            description = json.loads(text)
        else:
            description = {"type": "scene", "file": str(path.resolve()), "text": text}
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: the scene can't be read: {error}") from error
    _, state = _parsed(mi, description)
    views = {
        kind: [_view_of(node, path) for node in state.nodes if node.props.plugin_name() == kind]
        for kind in ("perspective", "projector")
    }
    if not views["perspective"]:
        raise InputError(
            f"{path}: the scene has no sensor of type perspective; expected one, which the camera "
            "takes its place and field of view from"
        )
    return World(
        path.stem,
        "a scene of your own",
        lambda: description,
        tuple(views["perspective"][:1]),
        tuple(views["projector"][:1]) or None,
    )


def load_scene(world: World) -> Any:
    """Return Mitsuba's scene of a world: its shapes, without emitters.

    Raises
    ------
    InputError
        When Mitsuba can't make it: says what Mitsuba said.
    """
    mi = load_mitsuba()
    config, state = _parsed(mi, world.build())
    kinds = mi.ObjectType
    left_out = {getattr(kinds, name) for name in _LEFT_OUT}
    gone = {index for index, node in enumerate(state.nodes) if node.type in left_out}
    for node in state.nodes:
        for key in list(node.props):
            kind = node.props.type(key)
            if kind == mi.Properties.Type.ResolvedReference and node.props[key].index() in gone:
                del node.props[key]
    with _mitsuba_errors(world.name):
        scene = mi.parser.instantiate(config, state)
    if not scene.shapes():
        raise InputError(f"scene {world.name}: there is no shape in it, so no light comes back")
    return scene


def _parsed(mi: Any, description: dict[str, Any]) -> tuple[Any, Any]:
    """Let Mitsuba parse a description, each shape for itself."""
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = False
    with _mitsuba_errors(str(description.get("file", "of this description"))):
        if "text" in description:
            state = mi.parser.parse_file(config, description["file"])
        else:
            state = mi.parser.parse_dict(config, _for_mitsuba(mi, description))
        mi.parser.transform_all(config, state)
    return config, state


@contextmanager
def _mitsuba_errors(name: str) -> Iterator[None]:
    """Turn what Mitsuba raises into an InputError that names the scene."""
    try:
        yield
    except (RuntimeError, TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"scene {name}: Mitsuba can't make it: {error}; correct the scene, or install the "
            "plugin that it names"
        ) from error


def _view_of(node: Any, path: Path) -> View:
    """Return the view of a sensor or a projector."""
    matrix = np.array(node.props.get("to_world").matrix, dtype=np.float64).reshape(4, 4)
    if node.props.get("fov_axis", "x") not in {"x", "smaller"}:
        raise InputError(f"{path}: fov_axis is {node.props['fov_axis']}; expected x")
    origin, ahead = matrix[:3, 3], matrix[:3, 2]
    place, target, up = (
        (float(x), float(y), float(z)) for x, y, z in (origin, origin + ahead, matrix[:3, 1])
    )
    return View(place, target, up, float(node.props.get("fov", 40.0)))


def _for_mitsuba(mi: Any, value: Any, key: str = "") -> Any:
    """Turn plain data into what Mitsuba takes: matrices of `to_world`, pictures of `bitmap`."""
    if isinstance(value, dict):
        return {name: _for_mitsuba(mi, each, name) for name, each in value.items()}
    if key == "to_world" and isinstance(value, list):
        return mi.ScalarTransform4f(np.array(value, dtype=np.float64))
    if key == "bitmap" and isinstance(value, np.ndarray):
        return mi.Bitmap(value)
    return value
