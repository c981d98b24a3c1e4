"""How the methods get through numerically hard scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.config.base import MethodSettings
from rfpipe.errors import RfpipeError
from rfpipe.scenes.base import CoaxialScene
from rfpipe.scenes.hard import hard_cases
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.settings import acquire_options

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig, Config
    from rfpipe.transport import Transport

__all__ = ["stability_row", "stability_study"]

_AS_DARK_AS_IT_IS = ("photon_starved",)
"""Cases that the camera isn't exposed for: they are hard for being dark."""


def stability_study(config: Config) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Acquire every hard case with both methods from exact radiance, and through the camera.

    Returns
    -------
    rows : list of dict
        See `stability_row`.
    arrays : dict
        Empty.
    """
    from rfpipe.config import CameraConfig

    configured = (config.camera or CameraConfig()).model_copy(update={"bayer": None})
    rows = []
    for name, make in hard_cases().items():
        scene = make()
        camera = configured if name in _AS_DARK_AS_IT_IS else _exposed_for(scene, configured)
        rows.append(stability_row(name, scene, "symmetric", None, config))
        rows.append(stability_row(name, scene, "symmetric", camera, config))
        rows.append(stability_row(name, scene, "dual", None, config))
    return rows, {}


def _exposed_for(scene: CoaxialScene, camera: CameraConfig) -> CameraConfig:
    """Set a camera's aperture so that the scene's floodlit maximum is a radiance of 1 to it."""
    brightest = float(scene.apply(np.ones((1, int(np.prod(scene.shape))), np.float32)).max())
    if brightest <= 0:
        return camera
    return camera.model_copy(
        update={"electrons_per_radiance": camera.electrons_per_radiance / brightest}
    )


def stability_row(
    name: str, scene: CoaxialScene, method: str, camera: CameraConfig | None, config: Config
) -> dict[str, Any]:
    """Acquire one small scene and compare the whole matrix with the truth.

    Parameters
    ----------
    name : str
    scene : CoaxialScene
        Small enough for its dense matrix.
    method : str
    camera : CameraConfig or None
        None for exact radiance.
    config : Config
        For the seed and the settings of the acquisition.

    Returns
    -------
    dict
        ``case``, ``scene``, ``rays``, ``method``, ``camera``; ``patterns``; ``matrix_error``:
        relative Frobenius error of T over all channels; ``relight_error``: the largest relative
        error of a reference pattern's image; ``accumulation``: relative difference of the
        floodlit image summed in float32 by relighting and in float64 over all entries;
        ``refused``: the message where the acquisition was refused, else "". What doesn't apply
        is None.
    """
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.stages.acquire import acquire

    row: dict[str, Any] = {
        "case": name,
        "scene": scene.describe()["scene"],
        "rays": int(np.prod(scene.shape)),
        "method": method,
        "camera": "exact" if camera is None else f"{camera.bits} bits",
        **dict.fromkeys(("patterns", "matrix_error", "relight_error", "accumulation")),
        "refused": "",
    }
    rig = SimulatedRig(scene, sensor_from_config(camera), config.seed)
    section = config.methods.get(method) or MethodSettings.model_of(method)()
    try:
        result = acquire(rig, progress=False, **acquire_options(config, method, section))
    except RfpipeError as error:
        return {**row, "refused": str(error)}
    return {**row, "patterns": result.patterns, **_errors(result.transport, scene)}


def _errors(transport: Transport, scene: CoaxialScene) -> dict[str, float]:
    """Compare a transport with the scene's dense matrix."""
    truth = np.stack([scene.dense(channel) for channel in range(scene.channels)])
    rays = truth.shape[-1]
    pixels = np.eye(rays, dtype=np.float32).reshape(rays, *scene.shape)
    columns = transport.relight_batch(pixels).reshape(rays, rays, scene.channels)
    matrix = columns.transpose(2, 1, 0).astype(np.float64)
    floodlit = transport.relight(np.ones(scene.shape, np.float32))
    summed = matrix.sum(axis=2).T.reshape(floodlit.shape)
    patterns = np.stack(list(relighting_patterns(scene.shape).values()))
    relit = transport.relight_batch(patterns)
    true = scene.apply(patterns.reshape(len(patterns), -1)).reshape(relit.shape)
    errors = [relative_rms(image, wanted) for image, wanted in zip(relit, true, strict=True)]
    defined = [error for error in errors if not np.isnan(error)]
    return {
        "matrix_error": relative_rms(matrix, truth),
        "relight_error": max(defined, default=float("nan")),
        "accumulation": relative_rms(floodlit, summed),
    }
