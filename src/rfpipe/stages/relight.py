"""Stage: relight a transport with the reference patterns, beside the truth where it is known."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.stages.evaluating.slices import leaf_levels, line_patterns
from rfpipe.stages.merging.references import read_floodlit
from rfpipe.stages.plan import AcquisitionFolder
from rfpipe.stages.results import accept_bundle, write_bundle
from rfpipe.store import read_manifest
from rfpipe.transport import Transport, open_transport
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    from rfpipe.config import SceneConfig
    from rfpipe.scenes import Scene

__all__ = [
    "images_of",
    "one_view_at_a_time",
    "relit_arrays",
    "relit_of_captured",
    "right_half",
    "run",
]

Float = NDArray[np.float32]

_AT_A_TIME = 32


def images_of(scene: Scene, patterns: Float) -> Float:
    """Return a scene's exact images ``(P, *shape, C)`` under patterns ``(P, *shape)``."""
    return scene.apply(patterns).reshape(len(patterns), *scene.shape, scene.channels)


def right_half(shape: tuple[int, ...]) -> Float:
    """Return the pattern of [Fig. 5.9]: the right half lit, the middle column of odd ones dark."""
    pattern = np.zeros(shape, np.float32)
    _, width = RayDomain(shape).image_shape
    pattern[..., (width + 1) // 2 :] = 1
    return pattern


def one_view_at_a_time(shape: tuple[int, ...]) -> Float:
    """Return the patterns ``(V, *shape)`` that each light one of V views, in turn."""
    domain = RayDomain(shape)
    patterns = np.zeros((domain.views, *domain.stack_shape), np.float32)
    patterns[range(domain.views), range(domain.views)] = 1
    return patterns.reshape(domain.views, *shape)


def relit_arrays(transport: Transport, scene: Scene) -> dict[str, NDArray[Any]]:
    """Compute all that the report shows of one transport, beside the truth.

    Parameters
    ----------
    transport : Transport
        Of a coaxial rig.
    scene : Scene
        The scene that it was acquired from, over one image or several views.

    Returns
    -------
    dict of ndarray
        ``patterns`` (P, *shape), ``relit`` and ``truth`` (P, *shape, C): the reference patterns.
        ``floodlit_relit``, ``floodlit_truth``, ``albedo`` (*shape, C). ``levels_relit``
        (L, *shape, C): the vertical bar relit by the transport truncated at each level.

        Of images: ``half_relit``, ``half_truth`` (H, W, C). ``line_relit``, ``line_truth``
        (W, W, C): the entries of T between the rays of the middle row, camera rays down,
        projector rays across. ``line_levels`` (W, W), see `leaf_levels`, where the transport has
        leaves.

        Of a stack: ``views_relit``, ``views_truth`` (V, V, H, W, C): what each view (second axis)
        sees in the light of each view (first axis).

        Radiance as float32.

    Raises
    ------
    InputError
        When transport and scene differ in shape or channels.
    """
    from rfpipe.scenes import scene_patterns

    shape, channels = scene.shape, scene.albedo.shape[-1]
    if (transport.camera_shape, transport.projector_shape) != (shape, shape):
        raise InputError(
            f"a transport from {transport.projector_shape} to {transport.camera_shape} rays isn't "
            f"of a coaxial scene of {shape}"
        )
    if transport.channels != channels:
        raise InputError(f"a transport of {transport.channels} channels, a scene of {channels}")
    patterns = np.stack(list(scene_patterns(scene).values()))
    every = np.concatenate([patterns, np.ones((1, *shape), np.float32)])
    relit, truth = transport.relight_batch(every), images_of(scene, every)
    return {
        "patterns": patterns,
        "relit": relit[:-1],
        "truth": truth[:-1],
        "floodlit_relit": relit[-1],
        "floodlit_truth": truth[-1],
        "albedo": scene.albedo,
        "levels_relit": _at_each_level(transport, patterns[0]),
        **(_between_views if RayDomain(shape).is_stack else _within_image)(transport, scene),
    }


def relit_of_captured(transport: Transport, floodlit: Float) -> dict[str, NDArray[Any]]:
    """Compute what the report shows of a transport whose scene is a real one.

    Parameters
    ----------
    transport : Transport
    floodlit : ndarray of float32, shape (*camera_shape, C)
        The image that the rig took under the all-on pattern.

    Returns
    -------
    dict of ndarray
        ``patterns`` (P, *projector_shape), ``relit`` (P, *camera_shape, C), ``levels_relit``
        (L, *camera_shape, C), ``floodlit_relit`` and ``floodlit_captured`` (*camera_shape, C), as
        in `relit_arrays`.
    """
    from rfpipe.scenes import relighting_patterns

    shape = transport.projector_shape
    patterns = np.stack(list(relighting_patterns(shape).values()))
    relit = transport.relight_batch(np.concatenate([patterns, np.ones((1, *shape), np.float32)]))
    return {
        "patterns": patterns,
        "relit": relit[:-1],
        "floodlit_relit": relit[-1],
        "floodlit_captured": floodlit,
        "levels_relit": _at_each_level(transport, patterns[0]),
    }


def _at_each_level(transport: Transport, pattern: Float) -> Float:
    """Relight by the transport truncated at each level, (L, *camera_shape, C)."""
    n_levels = 1 + max((int(entry["level"]) for entry in transport.level_rows), default=0)
    return np.stack([transport.truncate(level).relight(pattern) for level in range(n_levels)])


def _between_views(transport: Transport, scene: Scene) -> dict[str, NDArray[Any]]:
    """Return the arrays that `relit_arrays` has of a stack alone."""
    lights = one_view_at_a_time(scene.shape)
    relit, truth = transport.relight_batch(lights), images_of(scene, lights)
    shape = (len(lights), *RayDomain(scene.shape).stack_shape, scene.channels)
    return {"views_relit": relit.reshape(shape), "views_truth": truth.reshape(shape)}


def _within_image(transport: Transport, scene: Scene) -> dict[str, NDArray[Any]]:
    """Return the arrays that `relit_arrays` has of images alone."""

    def truth_of(patterns: Float) -> Float:
        return images_of(scene, patterns)

    shape = scene.shape
    half, row = right_half(shape), shape[0] // 2
    arrays: dict[str, NDArray[Any]] = {
        "half_relit": transport.relight(half),
        "half_truth": truth_of(half[None])[0],
        "line_relit": _entries(transport.relight_batch, shape, row),
        "line_truth": _entries(truth_of, shape, row),
    }
    levels = leaf_levels(transport, row)
    if levels is not None:
        arrays["line_levels"] = levels
    return arrays


def _entries(light: Callable[[Float], Float], shape: tuple[int, ...], row: int) -> Float:
    """Return the entries (W, W, C) of T between the rays of a row: camera down, projector across.

    `light` turns patterns (P, H, W) into images (P, H, W, C).
    """
    _, width = RayDomain(shape).image_shape
    columns = [
        light(line_patterns(shape, row, range(first, min(first + _AT_A_TIME, width))))[:, row]
        for first in range(0, width, _AT_A_TIME)
    ]
    return np.concatenate(columns).swapaxes(0, 1)


def run(folder: Path, scene: SceneConfig, code: str) -> None:
    """Relight the transport of an acquisition; write ``relight.zarr`` and ``relight.json``.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``, with ``transport.zarr`` and ``transport.json``; for a
        captured scene with what the merge of level 0 left, too.
    scene : SceneConfig
        The scene that it was acquired from.
    code : str
        Fingerprint of the code behind the stage.
    """
    from rfpipe.scenes import relighting_patterns, scene_from_config, scene_patterns

    store, manifest = folder / "relight.zarr", folder / "relight.json"
    acquired = read_manifest(folder / "transport.json")
    made_from = fingerprint({"transport": acquired["digest"], "scene": scene, "code": code})
    if accept_bundle(store, manifest, made_from):
        return
    transport = open_transport(folder / "transport.zarr")
    if scene.is_captured:
        floodlit, _ = read_floodlit(AcquisitionFolder(folder))
        arrays = relit_of_captured(transport, floodlit)
        names = list(relighting_patterns(transport.projector_shape))
    else:
        simulated = scene_from_config(scene)
        arrays = relit_arrays(transport, simulated)
        names = list(scene_patterns(simulated))
    facts = {
        "stage": "relight",
        "scene": acquired["scene"],
        "method": acquired["method"],
        "names": names,
        "row": RayDomain(transport.projector_shape).image_shape[0] // 2,
        "patterns": acquired["patterns"],
        "bytes": transport.nbytes,
        "levels": transport.level_rows,
        "options": acquired["options"],
        "units": RADIANCE_UNIT,
    }
    write_bundle(store, manifest, made_from, arrays, facts)
