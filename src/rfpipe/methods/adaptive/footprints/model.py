"""Candidates and indirect light found in turn, each from what the other leaves of the pictures.

The model is ``T = D + f L S R^T g``: footprints D, sparse; indirect light that is smooth up to the
factors f and g. Neither is known at first. A rough D is enough to tell how the projector's pixels
lie among the camera's, and so for a first S; what S leaves of the pictures makes a better D.

Each view of a projector that has several is lit by patterns of its own: a camera pixel has
footprints on each. Where cameras share these rays, both ways are one and the same light.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.candidates import (
    Candidates,
    Precision,
    averaged,
    by_view,
    first_footprints,
    found_anew,
    is_symmetric,
    joined,
    on_view,
    reconciled,
    reweighted,
    with_other_way,
)
from rfpipe.methods.adaptive.footprints.exchange import FULLY, NEARLY, ROUGHLY, Exchange
from rfpipe.methods.adaptive.footprints.functions import (
    Chart,
    Functions,
    camera_factor,
    carry_of,
    chart_of,
    projector_factor,
    shared_rays,
)
from rfpipe.methods.adaptive.footprints.matching import Templates
from rfpipe.methods.adaptive.footprints.series import Float, Int64, Series
from rfpipe.methods.images import beyond_noise
from rfpipe.methods.near_far.patterns import SEED
from rfpipe.provenance import generator
from rfpipe.transport.multiscale import (
    cells,
    coarsest_scale,
    functions_over,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Camera rays that fits of a light field look at, of more.
_ENOUGH = 4096

Views = tuple[Series, ...]
Channel = tuple[Candidates, Exchange]


@dataclass(frozen=True)
class Effort:
    """Limits of the fits of indirect light.

    Attributes
    ----------
    camera_rays : int
        Camera rays in the fits, at most; a random subset of more.
    unknowns : int
        Unknowns of the finest basis, at most.
    """

    camera_rays: int
    unknowns: int = 1_500_000


@dataclass(frozen=True)
class Model:
    """What pictures tell: the sum of channels, where a later search begins, and each of them."""

    grey: Candidates
    channels: tuple[Channel, ...]


def find(
    camera: RayDomain,
    projector: RayDomain,
    grey: Views,
    channels: Iterable[Views],
    before: Candidates | None,
    effort: Effort | None = None,
) -> Model:
    """Find the model.

    Footprints are searched for twice when nothing is known, once in later rounds, where `before` is
    an earlier model's `Model.grey`. By default the fits of indirect light use 4,096 camera rays for
    a projector of several views, else all of them. `grey` is the sum of the channels, pictures of
    patterns on each of the projector's views; of `channels` each is fitted before the next is asked
    for, none where the sum is the only channel.
    """
    rays, view = projector.rays_per_image, RayDomain(projector.image_shape)
    templates = []
    for series in grey:
        # projector pixels of a view that a shining camera pixel spans a side, about
        density = np.sqrt(rays / max(1.0, float(series.shining.sum()) / camera.views))
        templates.append(Templates.of(view, series.lit, float(density)))
    fresh, looked_at = before is None, None
    effort = effort or Effort(_ENOUGH if len(grey) > 1 else camera.size)
    if camera.size > effort.camera_rays:
        random = generator(SEED, camera.size)
        looked_at = np.sort(random.permutation(camera.size)[: effort.camera_rays])
    found = before
    if found is None:
        pairs = zip(grey, templates, strict=True)
        found = joined([first_footprints(each, camera, template) for each, template in pairs], rays)
    for number in range(2 if fresh else 1):
        exchange = _refined(camera, projector, grey, found, looked_at, effort.unknowns)
        found = _searched(camera, grey, found, exchange.indirect(), templates, looked_at)
        if exchange.shares_rays:
            found = with_other_way(found, projector.size)
            found = _reweighted(grey, found, exchange.indirect())
        if number or not fresh:
            bright = (
                part.brighter(series).uncertain(series, 1.0, 0.02)
                for series, part in by_view(grey, found)
            )
            found = joined([*bright], rays)
    candidates, exchange = _settled(grey, found, exchange, FULLY)
    fitted = tuple(_of_channel(series, grey, candidates, exchange) for series in channels)
    return Model(candidates, fitted or ((candidates, exchange),))


def _searched(
    camera: RayDomain,
    grey: Views,
    found: Candidates,
    indirect: list[Float],
    templates: list[Templates],
    looked_at: Int64 | None,
) -> Candidates:
    """Look for footprints again, in what indirect light leaves of the pictures."""
    rays, parts = len(grey[0].lit), []
    sides = zip(by_view(grey, found), indirect, templates, strict=True)
    for (series, part), light, template in sides:
        anew = reweighted(series, found_anew(series, part, light, camera, template), light)
        # fits need all candidates of the rays that they look at, and of no other
        parts.append(anew if looked_at is None else anew.brighter(series, looked_at))
    return joined(parts, rays)


def _settled(
    series: Views, found: Candidates, exchange: Exchange, accuracy: tuple[float, int]
) -> Channel:
    """Find weights and exchange once more, with the footprints' last candidates."""
    if exchange.shares_rays:
        return _agreed(series, found, exchange)
    start = replace(exchange, precision=_precisions(series, found, exchange.looked_at))
    fitted = start.fitted(start.learned(), accuracy).with_gains()
    return _reweighted(series, found, fitted.indirect()), fitted


def _agreed(series: Views, found: Candidates, exchange: Exchange) -> Channel:
    """Find weights that agree both ways, and what is exchanged beside them, in turn.

    Where both ways are known to be alike, weights are known so well that little of them has to be
    marginalised.
    """
    rays = len(series[0].lit)
    everywhere, looked_at = rays * len(series), exchange.looked_at
    found = _reweighted(series, with_other_way(found, everywhere), exchange.indirect())
    for _ in range(2):
        found = reconciled(series, found, exchange.indirect())
        # footprints that agree have small deviations left
        pairs = [
            part.uncertain(each, 0.05, 0.003).looked_at(each, looked_at)
            for each, part in by_view(series, averaged(found, everywhere))
        ]
        start = replace(
            exchange,
            precision=tuple(Precision.of(*each) for each in pairs),
            series=tuple(
                replace(
                    each, observed=each.observed - part.matrix(len(each.observed), rays) @ each.lit
                )
                for each, part in pairs
            ),
        )
        exchange = start.fitted(start.learned(), NEARLY)
    return reconciled(series, found, exchange.indirect()), exchange


def _reweighted(series: Views, found: Candidates, indirect: list[Float]) -> Candidates:
    sides = zip(by_view(series, found), indirect, strict=True)
    return joined([reweighted(*side, light) for side, light in sides], len(series[0].lit))


def _precisions(series: Views, found: Candidates, looked_at: Int64 | None) -> tuple[Precision, ...]:
    sides = by_view(series, found)
    return tuple(Precision.of(*part.looked_at(each, looked_at)) for each, part in sides)


def _of_channel(series: Views, grey: Views, found: Candidates, exchange: Exchange) -> Channel:
    """Fit a channel, whose light differs little from that of the sum."""
    floodlit, all_light = _floodlit(series), _floodlit(grey)
    share = np.divide(floodlit, all_light, out=np.zeros_like(floodlit), where=all_light > 0)
    if not any(each.shines() for each in series):
        share[:] = 0
    rays = len(series[0].lit) * len(series)
    pixel = found.pixels(rays)
    start = Candidates(
        found.keys, found.variance * np.square(share[pixel]), found.weights * share[pixel]
    )
    carry = exchange.functions.carry
    usual = max(float(np.median(share[share > 0])) if (share > 0).any() else 0.0, 0.0)
    sent = carry.seen * (carry.means @ share) + (1 - carry.seen) * np.float32(usual)
    begun = replace(
        exchange,
        series=tuple(each.of(exchange.looked_at) for each in series),
        factors=(exchange.camera * share, (exchange.projector * sent).astype(np.float32)),
        gains=(np.ones_like(exchange.gains[0]), np.ones_like(exchange.gains[1])),
        unknowns=exchange.unknowns / np.float32(usual or 1.0),
    )
    if not share.any():
        return start, begun
    return _settled(series, start, begun, NEARLY)


def _floodlit(series: Views) -> Float:
    """Return what pixels show when all views are lit, at least 0, (pixels,)."""
    return sum((each.floodlit for each in series[1:]), series[0].floodlit)


def _refined(
    camera: RayDomain,
    projector: RayDomain,
    series: Views,
    found: Candidates,
    chosen: Int64 | None,
    most_unknowns: int,
) -> Exchange:
    """Add functions, scale by scale, where pictures differ from the model beyond noise."""
    direct, floodlit = found.matrix(camera.size, projector.size), _floodlit(series)
    chart = Chart(camera.shape)
    if len(series) > 1:  # what all views see of the middle one
        middle, rays = projector.views // 2, projector.rays_per_image
        own = on_view(found, middle, projector.views, rays).matrix(camera.size, rays)
        chart = chart_of(camera, own, projector.image_shape, series[middle].floodlit)
    shares = len(series) > 1 and camera == projector and is_symmetric(found, camera.size)
    carry = shared_rays(camera.size) if shares else carry_of(direct, floodlit)
    factor = camera_factor(direct, floodlit)
    expected = _indirect(series, floodlit, direct)
    mean = float(floodlit.mean(dtype=np.float64))
    scale = coarsest_scale(chart.shape)
    on_camera = [functions_over(scale, np.ones(cells(chart.shape, scale), np.bool_))]

    def functions() -> Functions:
        return Functions(chart.basis(np.concatenate(on_camera)), projector, carry)

    exchange = Exchange(
        functions(),
        _precisions(series, found, chosen),
        tuple(each.of(chosen) for each in series),
        (factor, projector_factor(carry, factor, floodlit)),
        (np.ones(camera.size, np.float32), np.ones(projector.size, np.float32)),
        np.zeros(0, np.float32),
        chosen,
    )
    exchange = _from_nothing(exchange, expected, mean)
    finer = scale
    while finer > 1:
        finer //= 2
        wanted = _wanting(chart, finer, exchange)
        if 2 * finer == scale:
            wanted[:] = True
        on_camera.append(functions_over(finer, wanted))
        more = functions()
        if more.count > most_unknowns:
            break
        exchange = _from_nothing(replace(exchange, functions=more), expected, mean)
    return exchange.fitted(exchange.learned(), FULLY)


def _from_nothing(exchange: Exchange, expected: float, mean: float) -> Exchange:
    """Fit with the deviations that are expected, then with those that are learned, then gains."""
    begun = replace(exchange, unknowns=np.zeros(exchange.functions.count, np.float32))
    first = begun.fitted(exchange.functions.deviations(expected, mean), ROUGHLY)
    return first.fitted(first.learned(), NEARLY).with_gains()


def _indirect(series: Views, floodlit: Float, direct: csr_array[np.float32]) -> float:
    """Return indirect light under full light."""
    if len(series) > 1:
        rest = floodlit - np.asarray(direct.sum(axis=1)).ravel()
        return max(float(rest.mean(dtype=np.float64)), 0.0)
    (only,) = series
    # from what pixels show that patterns leave dark
    lit: Float = np.asarray(direct.sum(axis=1)).ravel()
    share = (direct @ only.lit[:, 1:]) / np.maximum(lit, np.finfo(np.float32).tiny)[:, None]
    dark = (1 - np.clip(4 * share, 0, 1)) * only.known[:, None]
    # patterns light half of the projector
    light = 2 * float((np.where(dark > 0, only.observed[:, 1:], 0) * dark).sum(dtype=np.float64))
    return max(light, 0.0) / max(float(dark.sum(dtype=np.float64)), 1.0)


def _wanting(chart: Chart, scale: int, exchange: Exchange) -> NDArray[np.bool_]:
    """Find the cells of a scale wrong by more than noise and .004 of the floodlight."""
    shape, cell = cells(chart.shape, scale), chart.cell_of(scale)
    if exchange.looked_at is not None:
        cell = cell[exchange.looked_at]
    wrong, noise, allowed = exchange.beyond(0.004)
    return beyond_noise(shape, cell, wrong, noise, noise, allowed)
