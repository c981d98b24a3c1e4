"""Direct light and smooth indirect light from few pictures, by regularised least squares.

The model is ``T = diag(d) + F B S B^T F``: direct light d, and indirect light that is smooth up to
the floodlit image F on both sides. What the floodlit image shows fixes d, so that a picture c of
pattern p tells of S alone: ``c - F p = F (B S B^T F p - p B S B^T F 1)``. On dark pixels that is
the indirect light itself, measured without the noise of the direct.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.estimate import relit
from rfpipe.methods.adaptive.smooth_fit import (
    Evidence,
    Observations,
    Patches,
    expected,
    solve,
)
from rfpipe.methods.base import Float
from rfpipe.methods.images import Pictures, beyond_noise
from rfpipe.methods.smooth_light import learned_deviations
from rfpipe.transport.base import Transport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multiscale import (
    MultiscaleBasis,
    MultiscaleTransport,
    bounced,
    cells,
    coarsest_scale,
    functions_over,
)
from rfpipe.transport.sum import SumTransport

# Fractions of the floodlit image: what a model may be wrong by on a dark pixel before finer
# functions are added there, and what it is taken to be wrong by in any case. A basis that is finer
# than the pictures can tell makes errors larger; on scenes with one, two and three creases the best
# values lay between half and twice these, flatly.
_REFINED_AT = 0.005
_WEIGHED_AT = 0.002
# A basis does not grow beyond so many pairs, which take a gigabyte while they are found.
_MOST_PAIRS = 2**24


@dataclass(frozen=True)
class Smooth:
    """Smooth indirect light: int32 functions (n, 4) of `MultiscaleBasis`, cores (C, pairs)."""

    shape: Sequence[int]
    functions: NDArray[np.int32]
    cores: Float

    @cached_property
    def basis(self) -> MultiscaleBasis:
        """The functions."""
        return MultiscaleBasis(tuple(self.shape), self.functions)


def fit(shape: tuple[int, ...], pictures: Pictures) -> Smooth:
    """Find which functions the scene needs, and the light that they exchange.

    All channels together tell most; what one of them alone tells is found from there.
    """
    grey = pictures.grey()
    evidence = Evidence.of(grey, _WEIGHED_AT)
    patches = Patches(_refined_basis(shape, grey, evidence))
    basis = patches.basis
    cores = np.zeros((pictures.channels, len(basis.first)), np.float32)
    if not grey.shine():
        return Smooth(shape, basis.functions, cores)
    observed = Observations.of(patches, evidence)
    deviations, group = expected(basis, evidence)
    # from nothing: cores that fewer pictures told keep the prior that is learned from drawing near
    near = solve(observed, deviations, 1e-3, 120)
    deviations = learned_deviations(group, near)
    estimate = solve(observed, deviations, 1.5e-4, 300, near)
    for index in range(pictures.channels):
        channel = pictures.channel(index)
        if pictures.channels == 1:
            cores[index] = estimate
        elif channel.shine():
            single = Evidence.of(channel, _WEIGHED_AT)
            scale = np.float32(single.core / evidence.core if evidence.core else 0)
            cores[index] = solve(
                Observations.of(patches, single), scale * deviations, 3e-4, 300, scale * estimate
            )
    return Smooth(shape, basis.functions, cores)


def _refined_basis(
    shape: tuple[int, ...], pictures: Pictures, evidence: Evidence
) -> MultiscaleBasis:
    """Add functions, scale by scale, where pictures differ from the model beyond noise."""
    scale = coarsest_scale(shape)
    functions = [functions_over(scale, np.ones(cells(shape, scale), np.bool_))]
    basis = MultiscaleBasis(shape, functions[0])
    while scale > 1 and pictures.shine():
        observed = Observations.of(Patches(basis), evidence)
        cores = solve(observed, expected(basis, evidence)[0], 3e-3, 60)
        scale //= 2
        probes = pictures.probes
        light = bounced(basis, basis.pairs, cores, pictures.floodlit[0], probes.lit)
        wanted = _wanting(shape, scale, pictures, probes.radiance[:, 0] - light)
        functions.append(functions_over(scale, wanted))
        finer = MultiscaleBasis(shape, np.concatenate(functions))
        if len(finer.first) > _MOST_PAIRS:
            break
        basis = finer
    return basis


def _wanting(
    shape: tuple[int, ...], scale: int, pictures: Pictures, wrong: Float
) -> NDArray[np.bool_]:
    """Find the cells of a scale whose dark pixels the model gets wrong by `wrong`, beyond noise."""
    probes = pictures.probes
    dark = pictures.known & ~probes.lit
    variance = np.where(dark, probes.variance[:, 0], 0)
    noise = variance.sum(axis=0, dtype=np.float64)
    squares = np.where(dark, wrong * wrong, 0).sum(axis=0, dtype=np.float64)
    chance = np.square(variance, dtype=np.float64).sum(axis=0)
    allowed = (_REFINED_AT * pictures.floodlit[0].astype(np.float64)) ** 2 * dark.sum(axis=0)
    return beyond_noise(*RayDomain(shape).squares(scale), squares, noise, chance, allowed)


@dataclass(frozen=True)
class LightRange:
    """Where the indirect light of each pixel comes from under floodlight.

    Attributes
    ----------
    reach : ndarray of float32, shape (*shape)
        Root mean square distance in pixels: at least half a pixel, at most the image's diagonal,
        which also stands where there is no such light.
    nearness : ndarray of float32, shape (*shape)
        Indirect light's share of the floodlit image, 0 to 1, over its reach.
    down, across : ndarray of float32, shape (*shape)
        Mean direction, not normalized; 0 where there is no such light.
    """

    reach: Float
    nearness: Float
    down: Float
    across: Float


def light_range(shape: tuple[int, ...], model: Smooth, floodlit: Float) -> LightRange:
    """Find where each pixel's indirect light comes from under floodlight."""
    height, width = RayDomain(shape).image_shape
    row, column = (np.broadcast_to(axis, shape).ravel() for axis in np.ogrid[:height, :width])
    square = row**2 + column**2
    moments = np.stack([np.ones_like(row), row, column, square]).astype(np.float32)
    basis = model.basis
    images = [
        bounced(basis, basis.pairs, cores, factor, moments)
        for cores, factor in zip(model.cores, floodlit, strict=True)
    ]
    # sums of large squares cancel
    light, down, across, squares = np.stack(images, axis=1).sum(axis=1, dtype=np.float64)
    total = light * square + squares - 2 * (row * down + column * across)
    diagonal = float(height**2 + width**2)
    there = light > 0
    values = np.divide(total, light, out=np.full(len(row), diagonal), where=there)
    reach = np.sqrt(np.clip(values, 0.25, diagonal))
    white = floodlit.sum(axis=0, dtype=np.float64)
    share = np.divide(light, white, out=np.zeros_like(light), where=white > 0)
    values = (
        reach,
        np.clip(share, 0, 1) / reach,
        np.where(there, down - row * light, 0),
        np.where(there, across - column * light, 0),
    )
    return LightRange(*(image.astype(np.float32).reshape(shape) for image in values))


def as_transport(
    shape: tuple[int, ...],
    rows: list[dict[str, Any]],
    model: Smooth | None,
    pictures: Pictures,
    more: Sequence[Transport] = (),
) -> SumTransport:
    """Return direct light, near-range and far-range light where there is any, as a sum.

    Direct is what the floodlit image has and the other parts don't, so that rows have the energy
    that was measured; of pixels that the pictures don't show it stays dark. Without a model all
    light counts as direct; `more` are other parts of indirect light.
    """
    parts = [*(() if model is None else _parts(shape, model, pictures)), *more]
    floodlit = pictures.floodlit
    direct = floodlit.copy()
    for part in parts:
        direct -= relit(part, pictures.lit[:1])[0]
    channels, rays = floodlit.shape
    arrays = {
        "diagonal": (direct * pictures.known).astype(np.float32),
        "left": np.zeros((channels, 0, rays), np.float32),
        "strengths": np.zeros((channels, 0), np.float32),
    }
    return SumTransport([LowRankTransport(shape, shape, channels, [], arrays), *parts], rows)


def _parts(shape: tuple[int, ...], model: Smooth, pictures: Pictures) -> Iterator[Transport]:
    """Yield near-range and far-range light, where there is any."""
    basis = model.basis
    near = basis.is_near(*basis.pairs)
    for chosen in (near, ~near):
        mask: NDArray[np.bool_] = chosen & model.cores.any(axis=0)
        if not mask.any():
            continue
        arrays = {
            "factor": pictures.floodlit,
            "functions": basis.functions,
            "pairs": np.stack([basis.first[mask], basis.second[mask]]),
            "cores": np.ascontiguousarray(model.cores[:, mask]),
        }
        yield MultiscaleTransport(shape, shape, pictures.channels, [], arrays)
