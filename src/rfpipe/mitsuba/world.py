"""A physically based scene as Mitsuba 3 describes it, apart from the rig that looks at it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from rfpipe.errors import InputError
from rfpipe.mitsuba.variant import load_mitsuba
from rfpipe.mitsuba.views import View
from rfpipe.provenance import fingerprint

# Within which light counts as that of a place which the camera sees by mirrors and lenses, relative
# to the footprint of a pixel there.
MERGING_RADIUS = 0.5


class Light(NamedTuple):
    """What light is followed, and how long.

    Attributes
    ----------
    bounces : int
        Most vertices of a path between projector and camera, at least 1: direct light alone.
    samples : int
        Paths a pixel, at least 2: half of them for either half.
    caustics : bool
        Whether light that the projector sends by mirrors and lenses is followed, too.
    seed : int
        Of the random numbers.
    """

    bounces: int
    samples: int
    caustics: bool
    seed: int

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        merging = {"merging_radius": MERGING_RADIUS} if self.caustics else {}
        return self._asdict() | merging


@dataclass(frozen=True)
class World:
    """A scene, the places of cameras and projectors before it, and the light that it needs.

    Attributes
    ----------
    name : str
    build : callable
        Returns the scene as a dict of Mitsuba's, in plain data: `to_world` as a list of four rows,
        `bitmap` as an array float32 (H, W, 3), a shape of type `mesh` with `vertices` float32
        (n, 3), `faces` uint32 (m, 3) and `bsdf`. Its sensors and emitters are left out.
    cameras : tuple of View
    projectors : tuple of View, or None
        None of a coaxial rig, whose projectors stand where its cameras stand.
    bounces : int, optional
        Vertices of a path of light from projector to camera that are worth following; None leaves
        it to the materials.
    caustics : bool, optional
        Whether mirrors or lenses throw light on surfaces, which is followed from the projector;
        None leaves it to the materials.
    """

    name: str
    build: Callable[[], dict[str, Any]]
    cameras: tuple[View, ...]
    projectors: tuple[View, ...] | None = None
    bounces: int | None = None
    caustics: bool | None = None

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints: the scene alone."""
        description = {**self.build(), "path": None}
        return {"name": self.name, "digest": fingerprint(description)}


def world_of_file(path: Path) -> World:
    """Return the scene of a file of Mitsuba's (XML).

    Its first perspective sensor is the camera, its first emitter of type projector the projector;
    without one the rig is coaxial.

    Raises
    ------
    InputError
        When the file can't be read or is no scene, or has no perspective sensor.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: the scene can't be read: {error}") from error
    description: dict[str, Any] = {"type": "scene", "path": str(path.resolve()), "text": text}
    _, state = _parsed(description, str(path))
    named = {str(node.props["filename"]) for node in state.nodes if "filename" in node.props}
    description["files"] = {  # digests of its meshes and pictures
        name: fingerprint(np.frombuffer((path.parent / name).read_bytes(), np.uint8))
        for name in sorted(named)
        if (path.parent / name).is_file()
    }
    camera, projector = (
        tuple(_view_of(node, path) for node in state.nodes if node.props.plugin_name() == kind)[:1]
        for kind in ("perspective", "projector")
    )
    if not camera:
        raise InputError(
            f"{path}: the scene has no sensor of type perspective; expected one, which the camera "
            "takes its place and field of view from"
        )
    return World(path.stem, lambda: description, camera, projector or None)


def load_scene(world: World) -> Any:
    """Return Mitsuba's scene of a world: its shapes, without emitters.

    Raises InputError with what Mitsuba said where Mitsuba can't make it.
    """
    mi = load_mitsuba()
    config, state = _parsed(world.build(), world.name)
    # what a rig brings along, or what asks for a renderer of another kind
    left_out = mi.ObjectType.Emitter, mi.ObjectType.Sensor, mi.ObjectType.Integrator
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


def _parsed(description: dict[str, Any], name: str) -> tuple[Any, Any]:
    """Let Mitsuba parse a description, each shape for itself."""
    mi = load_mitsuba()
    config = mi.parser.ParserConfig(mi.variant())
    config.merge_meshes = False
    with _mitsuba_errors(name):
        if "text" in description:
            state = mi.parser.parse_file(config, description["path"])
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
    placed = node.props.get("to_world", None)
    matrix = np.eye(4) if placed is None else np.array(placed.matrix, np.float64).reshape(4, 4)
    if node.props.get("fov_axis", "x") != "x":
        raise InputError(
            f"{path}: the fov_axis of {node.props.plugin_name()} is {node.props['fov_axis']}; "
            "expected x, the field of view across the picture's width"
        )
    left, up, ahead, origin = matrix[:3].T
    view = View(
        origin=tuple(origin),
        target=tuple(origin + ahead),
        up=tuple(up),
        degrees=float(node.props.get("fov", 40.0)),
    )
    if not np.allclose(view.pinhole((1, 1)).axes[0], -left, atol=1e-4):
        raise InputError(
            f"{path}: to_world of {node.props.plugin_name()} mirrors, scales or shears; expected a "
            "turn and a move, such as a lookat"
        )
    return view


def _for_mitsuba(mi: Any, value: Any, key: str = "") -> Any:
    """Turn plain data into what Mitsuba takes: matrices of `to_world`, pictures, meshes."""
    if isinstance(value, dict) and value.get("type") == "mesh":
        return _mesh(mi, value)
    if isinstance(value, dict):
        return {name: _for_mitsuba(mi, item, name) for name, item in value.items()}
    if key == "to_world" and isinstance(value, list):
        return mi.ScalarTransform4f(np.array(value, dtype=np.float64))
    if key == "bitmap" and isinstance(value, np.ndarray):
        return mi.Bitmap(value)
    return value


def _mesh(mi: Any, described: dict[str, Any]) -> Any:
    """Return a mesh of `vertices` (n, 3), `faces` (m, 3) and a `bsdf`, its normals smooth."""
    vertices, faces = described["vertices"], described["faces"]
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_for_mitsuba(mi, described["bsdf"]))
    mesh = mi.Mesh("mesh", len(vertices), len(faces), properties, has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.ravel()
    parameters.update()
    return mesh
