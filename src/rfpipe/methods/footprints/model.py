"""Footprints and indirect light found in turn, each from what the other leaves of the pictures.

The model is ``T = D + f L S R^T g``: footprints D, sparse; indirect light that is smooth up to the
factors f and g. Neither is known at first. A rough D is enough to tell how the projector's pixels
lie among the camera's, and so for a first S; what S leaves of the pictures makes a better D.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.candidates import (
    Footprints,
    Precision,
    first_footprints,
    found_anew,
    pruned,
    reweighted,
)
from rfpipe.methods.footprints.fit import FULLY, NEARLY, ROUGHLY, Exchange
from rfpipe.methods.footprints.functions import Functions
from rfpipe.methods.footprints.matching import Templates
from rfpipe.methods.footprints.series import Series
from rfpipe.methods.footprints.sides import Carry, camera_factor, carry_of, projector_factor
from rfpipe.methods.footprints.typed import Double, Float
from rfpipe.transport.multiscale.basis import (
    MultiscaleBasis,
    cells,
    coarsest_scale,
    functions_over,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = ["Channel", "Model", "find"]

# Finer functions come where pictures differ from the model by more than noise, so many standard
# deviations, and by more than this part of the floodlit image.
_SIGNIFICANT, _REFINED_AT = 3.0, 0.004
# A basis does not grow beyond so many unknowns.
_MOST_UNKNOWNS = 1_500_000
# A projector pixel that is less seen than this has fine functions of the projector's own.
_HALF_SEEN = 0.5


@dataclass(frozen=True)
class Channel:
    """Footprints and indirect light of one channel.

    Attributes
    ----------
    found : Footprints
    exchange : Exchange
    """

    found: Footprints
    exchange: Exchange


@dataclass(frozen=True)
class Model:
    """What pictures tell of the transport.

    Attributes
    ----------
    grey : Footprints
        Of the sum of the channels, with what a later search begins from.
    channels : tuple of Channel
    """

    grey: Footprints
    channels: tuple[Channel, ...]


def find(
    camera: RayDomain,
    projector: RayDomain,
    grey: Series,
    channels: list[Series],
    before: Footprints | None,
    passes: int,
) -> Model:
    """Find the model.

    Parameters
    ----------
    camera, projector : RayDomain
    grey : Series
        The sum of the channels.
    channels : list of Series
    before : Footprints or None
        As an earlier model's `Model.grey`; None at first.
    passes : int
        How often footprints are searched for again; at least 1.
    """
    density = np.sqrt(projector.size / max(1, int(grey.shining.sum())))
    templates = Templates.of(projector, grey.lit, float(density))
    found = before if before is not None else first_footprints(grey, projector, templates)
    fresh = before is None
    for number in range(passes):
        exchange = _refined(camera, projector, grey, found)
        indirect = exchange.indirect()
        found = found_anew(grey, found, indirect, templates)
        found = reweighted(grey, found, indirect)
        if number or not fresh:
            found = pruned(grey, found)
    exchange = _settled(grey, found, exchange)
    found = reweighted(grey, found, exchange.indirect())
    if len(channels) == 1:
        return Model(found, (Channel(found, exchange),))
    return Model(found, tuple(_of_channel(each, grey, found, exchange) for each in channels))


def _settled(series: Series, found: Footprints, exchange: Exchange) -> Exchange:
    """Fit the exchange once more, with the footprints' last candidates."""
    own = replace(exchange, precision=Precision.of(series, found))
    return own.fitted(own.learned(), FULLY).with_gains()


def _of_channel(series: Series, grey: Series, found: Footprints, exchange: Exchange) -> Channel:
    """Fit a channel, whose light differs little from that of the sum."""
    rays = len(series.lit)
    share = np.divide(
        series.floodlit,
        grey.floodlit,
        out=np.zeros_like(series.floodlit),
        where=grey.floodlit > 0,
    )
    if not series.shines():
        share[:] = 0
    own = found.pixels(rays)
    start = Footprints(
        found.keys, found.variance * np.square(share[own]), found.weights * share[own]
    )
    carry = exchange.functions.carry
    usual = max(float(np.median(share[share > 0])) if (share > 0).any() else 0.0, 0.0)
    sent = carry.seen * (carry.means @ share) + (1 - carry.seen) * np.float32(usual)
    begun = Exchange(
        exchange.functions,
        Precision.of(series, start),
        series,
        (exchange.camera * share, (exchange.projector * sent).astype(np.float32)),
        (np.ones_like(exchange.gains[0]), np.ones_like(exchange.gains[1])),
        exchange.unknowns / np.float32(usual or 1.0),
    )
    if not share.any():
        return Channel(start, begun)
    fitted = begun.fitted(begun.learned(), NEARLY).with_gains()
    return Channel(reweighted(series, start, fitted.indirect()), fitted)


def _refined(
    camera: RayDomain, projector: RayDomain, series: Series, found: Footprints
) -> Exchange:
    """Add functions, scale by scale, where pictures differ from the model beyond noise."""
    direct = found.matrix(camera.size, projector.size)
    carry = carry_of(direct, series.floodlit)
    factor = camera_factor(direct, series.floodlit)
    precision = Precision.of(series, found)
    expected = _indirect(series, direct)
    mean = float(series.floodlit.mean(dtype=np.float64))
    scale, top = coarsest_scale(camera.shape), coarsest_scale(projector.shape)
    on_camera = [functions_over(scale, np.ones(cells(camera.shape, scale), np.bool_))]
    on_projector = [_own(projector, carry, top, 0.0)]
    exchange = Exchange(
        Functions(
            MultiscaleBasis(camera.shape, on_camera[0]),
            MultiscaleBasis(projector.shape, on_projector[0]),
            carry,
        ),
        precision,
        series,
        (factor, projector_factor(carry, factor, series.floodlit)),
        (np.ones(camera.size, np.float32), np.ones(projector.size, np.float32)),
        np.zeros(0, np.float32),
    )
    exchange = _from_nothing(exchange, expected, mean)
    finer = scale
    while finer > 1:
        finer //= 2
        wanted = _wanting(camera, finer, exchange)
        if 2 * finer == scale:
            wanted[:] = True
            if top > 1:
                on_projector.append(_own(projector, carry, top // 2, _HALF_SEEN))
        on_camera.append(functions_over(finer, wanted))
        functions = Functions(
            MultiscaleBasis(camera.shape, np.concatenate(on_camera)),
            MultiscaleBasis(projector.shape, np.concatenate(on_projector)),
            carry,
        )
        if functions.count > _MOST_UNKNOWNS:
            break
        exchange = _from_nothing(replace(exchange, functions=functions), expected, mean)
    return exchange.fitted(exchange.learned(), FULLY)


def _from_nothing(exchange: Exchange, expected: float, mean: float) -> Exchange:
    """Fit with the deviations that are expected, then with those that are learned, then gains."""
    begun = replace(exchange, unknowns=np.zeros(exchange.functions.count, np.float32))
    first = begun.fitted(exchange.functions.deviations(expected, mean), ROUGHLY)
    return first.fitted(first.learned(), NEARLY).with_gains()


def _own(projector: RayDomain, carry: Carry, scale: int, least: float) -> NDArray[np.int32]:
    """Return the functions of a scale of the projector's own, where it isn't well seen."""
    unseen = 1 - carry.seen > max(least, 0.15)
    return functions_over(scale, _any_in_cells(projector, scale, unseen))


def _any_in_cells(domain: RayDomain, scale: int, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    views, down, across = cells(domain.shape, scale)
    found = np.zeros((views, down, across), np.bool_)
    view, row, column = np.nonzero(chosen.reshape(domain.stack_shape))
    found[view, row // scale, column // scale] = True
    return found


def _indirect(series: Series, direct: csr_array[np.float32]) -> float:
    """Return indirect light under full light, from what pixels show that patterns leave dark."""
    lit: Float = np.asarray(direct.sum(axis=1)).ravel()
    share = (direct @ series.lit[:, 1:]) / np.maximum(lit, np.finfo(np.float32).tiny)[:, None]
    dark = (1 - np.clip(4 * share, 0, 1)) * series.known[:, None]
    # patterns light half of the projector
    seen = 2 * float((np.where(dark > 0, series.seen[:, 1:], 0) * dark).sum(dtype=np.float64))
    return max(seen, 0.0) / max(float(dark.sum(dtype=np.float64)), 1.0)


def _wanting(camera: RayDomain, scale: int, exchange: Exchange) -> NDArray[np.bool_]:
    """Find the cells of a scale that the model gets wrong, beyond noise."""
    series, precision = exchange.series, exchange.precision
    wrong = series.seen - exchange.indirect()
    excess = np.einsum("im,im->i", wrong, precision.applied(wrong))
    count = series.lit.shape[1]
    free = np.where(series.known, count - np.minimum(precision.sizes, count // 2), 0)
    allowed = precision.trace * np.square(_REFINED_AT * series.floodlit)
    views, down, across = cells(camera.shape, scale)
    view, row, column = np.indices(camera.stack_shape).reshape(3, -1)
    cell = (view * down + row // scale) * across + column // scale

    def total(values: NDArray[Any]) -> Double:
        summed = np.bincount(cell, values.astype(np.float64), views * down * across)
        return summed.astype(np.float64)

    over, chance = total(excess) - total(free), np.sqrt(2 * total(free))
    wanted = (over > _SIGNIFICANT * chance) & (over > total(allowed))
    found: NDArray[np.bool_] = wanted.reshape(views, down, across)
    return found
