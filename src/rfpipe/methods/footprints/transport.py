"""What footprint acquisition found as a transport, and where its light stays near."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.model import Model
from rfpipe.methods.footprints.typed import Float
from rfpipe.transport.footprints.transport import FootprintTransport

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["arrays_of_model", "nearness", "spread_evenly"]

Arrays = dict[str, NDArray[Any]]


def arrays_of_model(model: Model, camera: RayDomain, projector: RayDomain, unit: float) -> Arrays:
    """Return the arrays of a `FootprintTransport`; the model is in units of so much radiance."""
    exchanges = [channel.exchange for channel in model.channels]
    functions = exchanges[0].functions
    direct = [each.found.matrix(camera.size, projector.size) for each in model.channels]
    cores = [functions.cores(each.unknowns) for each in exchanges]
    return {
        **_arrays("footprints", direct[0], [each.data * np.float32(unit) for each in direct]),
        **_arrays("left", functions.left),
        **_arrays("right", functions.right),
        **_arrays("cores", cores[0], [each.data for each in cores]),
        "camera_factor": np.stack([each.camera * np.float32(unit) for each in exchanges]),
        "projector_factor": np.stack([each.projector for each in exchanges]),
    }


def spread_evenly(floodlit: Float, rays: int) -> Arrays:
    """Return the arrays of a transport that knows the floodlit image (C, N) alone."""
    from scipy.sparse import csr_array

    channels, pixels = floodlit.shape
    nothing: Any = csr_array((pixels, rays), dtype=np.float32)
    one = np.ones((1, 1), np.float32)
    return {
        **_arrays("footprints", nothing, [nothing.data] * channels),
        **_arrays("left", csr_array(np.ones((pixels, 1), np.float32))),
        **_arrays("right", csr_array(np.ones((rays, 1), np.float32))),
        **_arrays("cores", csr_array(one), [np.full(1, 1 / rays, np.float32)] * channels),
        "camera_factor": np.maximum(floodlit, 0),
        "projector_factor": np.ones((channels, rays), np.float32),
    }


def nearness(transport: FootprintTransport, camera: RayDomain, projector: RayDomain) -> Float:
    """Return how much of each projector ray's light arrives near where it lights, (*shape).

    Its indirect light, radiance, over the root mean square distance, in pixels of the camera, from
    the ray's footprint; 0 where the camera sees no footprint. Of rays that the camera hardly sees,
    the picture would be next to black.
    """
    _, height, width = camera.stack_shape
    ray = np.arange(camera.size)
    row, column = ray // width % height, ray % width
    moments = np.stack([np.ones_like(row), row, column, row**2 + column**2]).astype(np.float32)
    light = np.repeat(moments[:, None], transport.channels, axis=1)
    channels = range(transport.channels)
    total = transport.adjoint(light, channels).sum(axis=1, dtype=np.float64)
    direct = transport.direct().adjoint(light, channels).sum(axis=1, dtype=np.float64)
    sent = np.maximum(direct[0], np.finfo(np.float32).tiny)
    down, across = direct[1] / sent, direct[2] / sent
    weight, to_row, to_column, squares = total - direct
    distance = weight * (down**2 + across**2) + squares - 2 * (down * to_row + across * to_column)
    there = (weight > 0) & (direct[0] > 0)
    mean = np.divide(distance, weight, out=np.ones_like(weight), where=there)
    reach = np.sqrt(np.clip(mean, 0.25, height**2 + width**2))
    found = np.where(there, weight / reach, 0)
    return found.astype(np.float32).reshape(projector.shape)


def _arrays(name: str, matrix: csr_array[Any], values: list[Float] | None = None) -> Arrays:
    """Return a sparse matrix, values channel by channel, as a `FootprintTransport` holds it."""
    held = matrix.data.astype(np.float32) if values is None else np.stack(values)
    kept = np.atleast_2d(held).any(axis=0)
    before = np.concatenate([[0], np.cumsum(kept)])
    return {
        name: np.ascontiguousarray(held[..., kept]),
        f"{name}_columns": matrix.indices[kept].astype(np.int32),
        f"{name}_starts": before[matrix.indptr].astype(np.int32),
    }
