"""Relight a transport with the reference patterns, and compute what is true of the scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import versions
from rfpipe.stages.slices import leaf_levels, line_patterns
from rfpipe.transport import Transport, open_transport

if TYPE_CHECKING:
    from rfpipe.config import SceneConfig

__all__ = ["SceneTruth", "images_of", "relight", "relit_arrays", "right_half"]

Float = NDArray[np.float32]

_AT_A_TIME = 64


class SceneTruth(Protocol):
    """The exact light transport of a scene over images (H, W)."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""

    @property
    def albedo(self) -> Float:
        """Albedo (H, W, C)."""

    def apply(self, patterns: Float) -> Float:
        """Radiance (B, N, C) under patterns (B, N)."""


def images_of(scene: SceneTruth, patterns: Float) -> Float:
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


def relit_arrays(transport: Transport, scene: SceneTruth) -> dict[str, NDArray[Any]]:
    """Compute all that the report shows of one transport, beside the truth.

    Parameters
    ----------
    transport : Transport
        Of a coaxial rig over images (H, W).
    scene : SceneTruth
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
    from rfpipe.scenes.relighting import relighting_patterns

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


def relight(
    transport_path: Path,
    scene: SceneConfig,
    store: Path,
    manifest: Path,
    *,
    names: tuple[str, str],
    fingerprint: str,
) -> None:
    """Relight a stored transport and write images, truth and a manifest.

    Parameters
    ----------
    transport_path : Path
        The ``transport.zarr`` of an acquisition.
    scene : SceneConfig
        The scene that it was acquired from.
    store : Path
        Bundle of arrays to write, see `relit_arrays`.
    manifest : Path
        Written last.
    names : (str, str)
        Scene and method, for the manifest.
    fingerprint : str
        Of the settings and the code that shape the result.
    """
    from rfpipe.scenes.reference import scene_from_config
    from rfpipe.scenes.relighting import RELIGHTING_PATTERNS
    from rfpipe.store.arrays import write_arrays
    from rfpipe.store.manifest import write_manifest

    transport = open_transport(transport_path)
    exact = scene_from_config(scene)
    arrays = relit_arrays(transport, exact)
    attributes = {
        "scene": names[0],
        "method": names[1],
        "patterns": list(RELIGHTING_PATTERNS),
        "row": exact.shape[0] // 2,
        "units": "radiance",
    }
    digest = write_arrays(store, arrays, attributes)
    write_manifest(
        manifest,
        {
            **attributes,
            "digest": digest,
            "fingerprint": fingerprint,
            "shape": list(exact.shape),
            "channels": exact.channels,
            "transport_bytes": transport.nbytes,
            "patterns_shown": sum(int(entry["patterns"]) for entry in transport.level_rows),
            "levels": transport.level_rows,
            "versions": versions(),
        },
    )
