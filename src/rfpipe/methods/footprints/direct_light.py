"""Direct light of the footprint model, as the error estimate and the residual model use it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rfpipe.array_types import Bools
from rfpipe.blocks import RayDomain
from rfpipe.methods.images import nearest_known, relight_white
from rfpipe.methods.residual.model import CameraCells, ProjectorCells, residual_cells, root_factor
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport

# Direct light below this fraction of a pixel's direct light in the floodlit image is dark.
_DARK = 0.02


def pixels_without_direct_light(direct: FootprintTransport, lit: Bools) -> Bools:
    """Find the camera pixels with at most 2 % of their direct light under each pattern.

    Parameters
    ----------
    direct : FootprintTransport
        Direct light, `FootprintTransport.direct`.
    lit : ndarray of bool, shape (P, N)
        The patterns.

    Returns
    -------
    ndarray of bool, shape (P, M)
    """
    patterns = np.concatenate([np.ones_like(lit[:1]), lit])
    floodlit, *images = relight_white(direct, patterns).sum(axis=1)
    return ~np.asarray(np.stack(images) > _DARK * floodlit)


def projector_cells(
    direct: FootprintTransport, model: Transport, camera_cells: CameraCells
) -> ProjectorCells:
    """Find the places in the camera's image that the residual cells of the projector light.

    Residual cells are the squares between which the residual model has light
    (`rfpipe.methods.residual`). The place of a cell is the mean place of its direct light. A cell
    that lights no camera pixel has the place of the nearest one that does.

    Parameters
    ----------
    direct : FootprintTransport
        Direct light.
    model : Transport
        All light, of which the residual is fitted; it gives the factor of the projector's rays.
    camera_cells : CameraCells
    """
    channels, camera = range(direct.channels), RayDomain(direct.camera_shape)
    cells = residual_cells(direct.projector_shape)
    light, *moments = cells.total(
        direct.adjoint(_moment_images(camera, channels), channels).sum(axis=1)
    ).T.astype(np.float64)
    lights_camera = light > 0
    places = np.stack(moments) / np.where(lights_camera, light, 1) / camera_cells.cells.side
    if lights_camera.any() and not lights_camera.all():
        places = places[:, nearest_known(lights_camera.reshape(cells.stack))]
    ones = np.ones((1, len(channels), camera.size), np.float32)
    ray_light = np.maximum(model.adjoint(ones, channels)[0], 0)
    return ProjectorCells(cells, root_factor(ray_light), places.T.astype(np.float32))


def _moment_images(camera: RayDomain, channels: Sequence[int]) -> np.ndarray:
    """Return the images 1, row and column in all channels, float32 (3, C, M)."""
    _, row, column = np.indices(camera.stack_shape).reshape(3, -1)
    images = np.stack([np.ones_like(row), row, column]).astype(np.float32)
    return np.repeat(images[:, None], len(channels), axis=1)
