"""The near/far model: direct light, and indirect light that varies smoothly.

    T = diag(d) + F B S B^T F

F, the floodlit image, carries the texture of the surfaces on both sides; between them indirect
light is smooth, the smoother the farther it travels. B are quadratic B-splines of many scales, S
has one entry, a *core*, for each pair of functions within reach (`MultiscaleBasis`). T is
symmetric: camera and projector of a coaxial rig share their rays. The floodlit image ``F = T 1``
fixes the direct light: ``d = F - F B S B^T F 1``.

======  ====================  ============  ========================================================
symbol  name in the code      shape         meaning and unit
======  ====================  ============  ========================================================
``T``   `near_far_transport`  (N, N)        light transport of a channel, radiance
``d``   `direct`              (C, N)        direct light, radiance
``F``   `floodlit`            (C, N)        floodlit image, radiance
``B``   `basis`               (N, n)        values of n functions on N rays, no unit; constant over
                                            each of the `cells`
``S``   `cores`               (C, pairs)    one entry for each pair of functions, inverse radiance
======  ====================  ============  ========================================================

The separation of direct from indirect light by patterns that light half of the pixels follows S. K.
Nayar et al., *Fast separation of direct and global components of a scene using high frequency
illumination*, SIGGRAPH 2006.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float, FunctionTable
from rfpipe.blocks import RayDomain
from rfpipe.methods.images import Pictures, relight_white
from rfpipe.transport.base import Transport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multiscale import MultiscaleBasis, MultiscaleTransport, relight_smooth
from rfpipe.transport.sum import SumTransport
from rfpipe.transport.wavelet import Cells


@dataclass(frozen=True)
class SmoothModel:
    """Smooth indirect light, ``B S B^T`` of each channel.

    Attributes
    ----------
    cells : Cells
        Cells of rays over which the functions are constant.
    functions : ndarray of int32, shape (n, 4)
        The functions B over the grid of cells, see `MultiscaleBasis`.
    cores : ndarray of float32, shape (C, pairs)
        S, in inverse radiance.
    """

    cells: Cells
    functions: FunctionTable
    cores: Float

    @cached_property
    def basis(self) -> MultiscaleBasis:
        """The functions B, over the grid of cells, and their pairs."""
        return MultiscaleBasis(self.cells.grid_shape, self.functions)


@dataclass(frozen=True)
class LightRange:
    """Distance and direction from which each pixel's indirect light comes under full light.

    Attributes
    ----------
    distance : ndarray of float32, shape (*shape)
        Root mean square distance in pixels: at least half a pixel, at most the image's diagonal,
        which pixels without indirect light have too.
    indirect_per_pixel : ndarray of float32, shape (*shape)
        Indirect light as a share of the floodlit image, 0 to 1, over the distance, in 1/pixel: it
        is large where much light comes from nearby.
    row_offset, column_offset : ndarray of float32, shape (*shape)
        Sums of the rows and columns of the light's origins relative to the pixel, weighted by the
        light, in radiance times pixels; 0 without indirect light.
    """

    distance: Float
    indirect_per_pixel: Float
    row_offset: Float
    column_offset: Float


def light_range(shape: tuple[int, ...], model: SmoothModel, floodlit: Float) -> LightRange:
    """Compute the distance and direction of each pixel's indirect light under full light.

    The model relights the images 1, row, column and row^2 + column^2: sums over the pixels that
    send the light, weighted by it, of their positions and squared positions.
    """
    height, width = RayDomain(shape).image_shape
    row, column = (np.broadcast_to(axis, shape).ravel() for axis in np.ogrid[:height, :width])
    square = row**2 + column**2
    moments = np.stack([np.ones_like(row), row, column, square]).astype(np.float32)
    basis = model.basis
    images = [
        relight_smooth(model.cells, basis, basis.pairs, cores, factor, moments)
        for cores, factor in zip(model.cores, floodlit, strict=True)
    ]
    # float64: sums of large squares cancel
    light, rows, columns, position_squares = np.stack(images, axis=1).sum(axis=1, dtype=np.float64)
    squared_distances = light * square + position_squares - 2 * (row * rows + column * columns)
    squared_diagonal = float(height**2 + width**2)
    is_lit = light > 0
    squared_distance = np.full(len(row), squared_diagonal)
    np.divide(squared_distances, light, out=squared_distance, where=is_lit)
    distance = np.sqrt(np.clip(squared_distance, 0.25, squared_diagonal))
    white = floodlit.sum(axis=0, dtype=np.float64)
    share = np.divide(light, white, out=np.zeros_like(light), where=white > 0)
    fields = (
        distance,
        np.clip(share, 0, 1) / distance,
        np.where(is_lit, rows - row * light, 0),
        np.where(is_lit, columns - column * light, 0),
    )
    return LightRange(*(image.astype(np.float32).reshape(shape) for image in fields))


def near_far_transport(
    shape: tuple[int, ...],
    rows: list[dict[str, Any]],
    model: SmoothModel | None,
    pictures: Pictures,
    more_parts: Sequence[Transport] = (),
) -> SumTransport:
    """Assemble direct, near-range and far-range light, and more parts, as a sum.

    Direct light is the floodlit image minus all parts of indirect light, so that the sum of each
    row of T is the energy that was measured. It is 0 where a pixel is unknown.

    Parameters
    ----------
    shape : tuple of int
        The ray domain.
    rows : list of dict
        The transport's table of levels.
    model : SmoothModel, optional
        Without one, all light that `more_parts` lack is direct.
    pictures : Pictures
        The floodlit picture comes first.
    more_parts : sequence of Transport
        Further parts of indirect light.
    """
    parts = [*(() if model is None else _smooth_parts(shape, model, pictures)), *more_parts]
    floodlit = pictures.floodlit
    direct = floodlit.copy()
    for part in parts:
        direct -= relight_white(part, pictures.lit[:1])[0]
    channels, rays = floodlit.shape
    arrays = {
        "diagonal": (direct * pictures.known).astype(np.float32),
        "left": np.zeros((channels, 0, rays), np.float32),
        "strengths": np.zeros((channels, 0), np.float32),
    }
    return SumTransport([LowRankTransport(shape, shape, channels, [], arrays), *parts], rows)


def _smooth_parts(
    shape: tuple[int, ...], model: SmoothModel, pictures: Pictures
) -> Iterator[Transport]:
    """Yield near-range light and far-range light, each unless it is 0."""
    basis = model.basis
    near = basis.is_near(*basis.pairs)
    for in_range in (near, ~near):
        pairs: NDArray[np.bool_] = in_range & model.cores.any(axis=0)
        if not pairs.any():
            continue
        arrays = {
            "side": np.array([model.cells.side], np.int32),
            "factor": pictures.floodlit,
            "functions": basis.functions,
            "pairs": np.stack([basis.first[pairs], basis.second[pairs]]),
            "cores": np.ascontiguousarray(model.cores[:, pairs]),
        }
        yield MultiscaleTransport(shape, shape, pictures.channels, [], arrays)
