"""Stage: relight a transport with the reference patterns, and compute what is true of the scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.stages.results import accept_bundle, write_bundle
from rfpipe.stages.slices import leaf_levels, line_patterns
from rfpipe.store import read_manifest
from rfpipe.transport import Transport, open_transport
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    from rfpipe.config import SceneConfig
    from rfpipe.scenes import Scene

__all__ = ["images_of", "relit_arrays", "right_half", "run"]

Float = NDArray[np.float32]

_AT_A_TIME = 64


def images_of(scene: Scene, patterns: Float) -> Float:
    """Return a scene's exact images ``(P, H, W, C)`` under patterns ``(P, H, W)``."""
    flat = patterns.reshape(len(patterns), -1)
    parts = [
        scene.apply(flat[first : first + _AT_A_TIME]) for first in range(0, len(flat), _AT_A_TIME)
    ]
    radiance = np.concatenate(parts)
    return radiance.reshape(len(patterns), *scene.shape, radiance.shape[-1])


def right_half(shape: tuple[int, ...]) -> Float:
    """Return the pattern of [Fig. 5.9]: the right half lit, the middle column of odd ones dark."""
    pattern = np.zeros(shape, np.float32)
    pattern[..., (shape[-1] + 1) // 2 :] = 1
    return pattern


def relit_arrays(transport: Transport, scene: Scene) -> dict[str, NDArray[Any]]:
    """Compute all that the report shows of one transport, beside the truth.

    Parameters
    ----------
    transport : Transport
        Of a coaxial rig over images (H, W).
    scene : Scene
        The scene that it was acquired from.

    Returns
    -------
    dict of ndarray
        ``patterns`` (P, H, W), ``relit`` and ``truth`` (P, H, W, C): the reference patterns.
        ``floodlit_relit``, ``floodlit_truth``, ``half_relit``, ``half_truth``, ``albedo``
        (H, W, C). ``line_relit``, ``line_truth`` (W, W, C): the entries of T between the rays of
        the middle row, camera rays down, projector rays across. ``line_levels`` (W, W), see
        `leaf_levels`, where the transport has leaves. ``levels_relit`` (L, H, W, C): the vertical
        bar relit by the transport truncated at each level. Radiance as float32.

    Raises
    ------
    InputError
        When transport and scene differ in shape or channels.
    """
    from rfpipe.scenes import relighting_patterns

    shape, channels = scene.shape, scene.albedo.shape[-1]
    if (transport.camera_shape, transport.projector_shape) != (shape, shape):
        raise InputError(
            f"a transport from {transport.projector_shape} to {transport.camera_shape} rays isn't "
            f"of a coaxial scene of {shape}"
        )
    if transport.channels != channels:
        raise InputError(f"a transport of {transport.channels} channels, a scene of {channels}")
    patterns = np.stack(list(relighting_patterns(shape).values()))
    more = np.stack([np.ones(shape, np.float32), right_half(shape)])
    every = np.concatenate([patterns, more])
    relit, truth = transport.relight_batch(every), images_of(scene, every)
    row = shape[0] // 2
    line = line_patterns(shape, row)
    n_levels = 1 + max((int(entry["level"]) for entry in transport.level_rows), default=0)
    bar = patterns[0]
    arrays: dict[str, NDArray[Any]] = {
        "patterns": patterns,
        "relit": relit[: len(patterns)],
        "truth": truth[: len(patterns)],
        "floodlit_relit": relit[-2],
        "floodlit_truth": truth[-2],
        "half_relit": relit[-1],
        "half_truth": truth[-1],
        "albedo": scene.albedo,
        "line_relit": transport.relight_batch(line)[:, row].swapaxes(0, 1),
        "line_truth": images_of(scene, line)[:, row].swapaxes(0, 1),
        "levels_relit": np.stack([transport.truncate(n).relight(bar) for n in range(n_levels)]),
    }
    levels = leaf_levels(transport, row)
    if levels is not None:
        arrays["line_levels"] = levels
    return arrays


def run(folder: Path, scene: SceneConfig, code: str) -> None:
    """Relight the transport of an acquisition; write ``relight.zarr`` and ``relight.json``.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``, with ``transport.zarr`` and ``transport.json``.
    scene : SceneConfig
        The scene that it was acquired from.
    code : str
        Fingerprint of the code behind the stage.
    """
    from rfpipe.scenes import RELIGHTING_PATTERNS, scene_from_config

    store, manifest = folder / "relight.zarr", folder / "relight.json"
    acquired = read_manifest(folder / "transport.json")
    made_from = fingerprint({"transport": acquired["digest"], "scene": scene, "code": code})
    if accept_bundle(store, manifest, made_from):
        return
    transport = open_transport(folder / "transport.zarr")
    exact = scene_from_config(scene)
    facts = {
        "stage": "relight",
        "scene": acquired["scene"],
        "method": acquired["method"],
        "names": list(RELIGHTING_PATTERNS),
        "row": exact.shape[0] // 2,
        "patterns": acquired["patterns"],
        "bytes": transport.nbytes,
        "levels": transport.level_rows,
        "tolerance": acquired["tolerance"],
        "units": RADIANCE_UNIT,
    }
    write_bundle(store, manifest, made_from, relit_arrays(transport, exact), facts)
