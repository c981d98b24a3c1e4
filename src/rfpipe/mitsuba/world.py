"""Descriptions of physically based scenes, and loading them with Mitsuba 3."""

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

# Radius within which light is merged with the end of a specular chain from the camera, relative to
# the footprint of its pixel there.
MERGING_RADIUS = 0.5


class TracingOptions(NamedTuple):
    """Parameters of tracing light.

    Attributes
    ----------
    bounces : int
        Maximum number of vertices between projector and camera; 1 is direct light only.
    samples : int
        Paths per pixel, at least 2; each half of the recording has half of them.
    caustics : bool
        True to trace light from the projector through mirrors and lenses.
    seed : int
        Seed of the random numbers.
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
    """A scene with its cameras, projectors and the parameters of tracing that it needs.

    Attributes
    ----------
    name : str
    build : callable
        Returns the scene as a dict for Mitsuba in plain data: `to_world` as a list of four rows,
        `bitmap` as an array float32 (H, W, 3), a shape of type `mesh` with `vertices` float32
        (n, 3), `faces` uint32 (m, 3) and `bsdf`. Sensors and emitters are ignored.
    cameras : tuple of View
    projectors : tuple of View, or None
        None for a coaxial rig, whose projectors coincide with its cameras.
    bounces : int, optional
        Maximum number of vertices of a path; None: chosen by the materials.
    caustics : bool, optional
        True to trace light from the projector through mirrors and lenses; None: chosen by the
        materials.
    """

    name: str
    build: Callable[[], dict[str, Any]]
    cameras: tuple[View, ...]
    projectors: tuple[View, ...] | None = None
    bounces: int | None = None
    caustics: bool | None = None

    def describe(self) -> dict[str, Any]:
        """Plain data of the scene for fingerprints."""
        description = {**self.build(), "path": None}
        return {"name": self.name, "digest": fingerprint(description)}


def world_of_file(path: Path) -> World:
    """Read the scene of an XML file of Mitsuba.

    The first sensor of type perspective or thinlens is the camera, and the first emitter of type
    projector the projector; without a projector, the rig is coaxial.

    Raises
    ------
    InputError
        When the file can't be read, isn't a scene, or has no such sensor.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: the scene can't be read: {error}") from error
    description: dict[str, Any] = {"type": "scene", "path": str(path.resolve()), "text": text}
    _, state = _parsed(description, str(path))
    filenames = {str(node.props["filename"]) for node in state.nodes if "filename" in node.props}
    description["files"] = {  # digests of meshes and textures
        name: fingerprint(np.frombuffer((path.parent / name).read_bytes(), np.uint8))
        for name in sorted(filenames)
        if (path.parent / name).is_file()
    }
    camera, projector = (
        tuple(_view_of(node, path) for node in state.nodes if node.props.plugin_name() in kinds)[:1]
        for kinds in (("perspective", "thinlens"), ("projector",))
    )
    if not camera:
        raise InputError(
            f"{path}: the scene has no sensor of type perspective or thinlens, which defines "
            "position and field of view of the camera; add one"
        )
    return World(path.stem, lambda: description, camera, projector or None)


def load_scene(world: World) -> Any:
    """Load the shapes of a world with Mitsuba, without emitters.

    Raises InputError with Mitsuba's message where Mitsuba can't load it.
    """
    mi = load_mitsuba()
    config, state = _parsed(world.build(), world.name)
    # the rig replaces emitters and sensors, the tracer the integrator
    replaced = mi.ObjectType.Emitter, mi.ObjectType.Sensor, mi.ObjectType.Integrator
    removed = {index for index, node in enumerate(state.nodes) if node.type in replaced}
    for node in state.nodes:
        for key in list(node.props):
            kind = node.props.type(key)
            if kind == mi.Properties.Type.ResolvedReference and node.props[key].index() in removed:
                del node.props[key]
    with _mitsuba_errors(world.name):
        scene = mi.parser.instantiate(config, state)
    if not scene.shapes():
        raise InputError(
            f"scene {world.name} has no shapes, so no light reaches the camera; add shapes"
        )
    return scene


def _parsed(description: dict[str, Any], name: str) -> tuple[Any, Any]:
    """Parse a description with Mitsuba, without merging shapes."""
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
    """Convert errors of Mitsuba to an InputError that names the scene."""
    try:
        yield
    except (RuntimeError, TypeError, ValueError, KeyError) as error:
        raise InputError(
            f"scene {name}: Mitsuba can't load it: {error}; correct the scene, or install the "
            "plugin that it needs"
        ) from error


def _view_of(node: Any, path: Path) -> View:
    """Build the view of a sensor or a projector."""
    to_world = node.props.get("to_world", None)
    matrix = np.eye(4) if to_world is None else np.array(to_world.matrix, np.float64).reshape(4, 4)
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
        aperture=2 * float(node.props.get("aperture_radius", 0.0)),
        focus=node.props.get("focus_distance", None),
    )
    if not np.allclose(view.pinhole((1, 1)).axes[0], -left, atol=1e-4):
        raise InputError(
            f"{path}: to_world of {node.props.plugin_name()} mirrors, scales or shears; expected a "
            "rotation and a translation, such as a lookat"
        )
    return view


def _for_mitsuba(mi: Any, value: Any, key: str = "") -> Any:
    """Convert plain data to objects of Mitsuba: matrices of `to_world`, bitmaps, meshes."""
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
    """Build a mesh of `vertices` (n, 3), `faces` (m, 3) and a `bsdf`, with smooth normals."""
    vertices, faces = described["vertices"], described["faces"]
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_for_mitsuba(mi, described["bsdf"]))
    mesh = mi.Mesh("mesh", len(vertices), len(faces), properties, has_vertex_normals=True)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.ravel()
    parameters["faces"] = faces.ravel()
    parameters.update()
    return mesh
