"""Footprints with smooth light, fitted to pictures of patterns chosen elsewhere.

As in footprint acquisition the model is ``T = D + diag(f) L S R^T diag(g)``
(`rfpipe.methods.footprints`):
few projector rays light each camera ray directly, and indirect light is smooth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.fitting.series import Series
from rfpipe.fitting.surfaces import expected_boxes, smoothed, surfaces_of
from rfpipe.methods.footprints.candidates import StoredCandidates
from rfpipe.methods.footprints.fit import fit_model
from rfpipe.methods.footprints.model import ChannelModel, transport_arrays
from rfpipe.methods.footprints.pictures import ViewArrays
from rfpipe.methods.footprints.problem import FitLimits
from rfpipe.transport.footprints import FootprintTransport

# On real Gray code (camera of 120 x 160, 30 pictures), 1.4 million unknowns in the fits of indirect
# light took 4 times as long as 30,000 and placed footprints no better.
_LIMITS = FitLimits(camera_rays=2048, core_parts=30_000)
# Fewer patterns don't distinguish footprints.
LEAST_PICTURES = 6
# Squares along the projector's longer side under which smooth light is tested, and the part of it
# that is rounding.
_SQUARES, _ROUNDING = 16, 1e-5
# Largest unevenness of the combination of patterns for white, and its ridge.
_MOST_UNEVEN, _RIDGE = 0.3, 1e-3


def unfit_for_footprints(series: Series) -> str:
    """Return why footprints can't be fitted to pictures, or an empty string."""
    if RayDomain(series.projector_shape).views > 1 or RayDomain(series.camera_shape).views > 1:
        return "there are several views"
    if series.patterns.shape[1] > 1:
        return "patterns are coloured"
    if series.is_complete:
        return "the patterns determine each ray by themselves"
    if len(series.patterns) < LEAST_PICTURES:
        return f"there are {len(series.patterns)} pictures, fewer than {LEAST_PICTURES}"
    if _white_weights(series.patterns[:, 0]) is None:
        return "no combination of patterns gives white"
    return ""


def solve_footprints(series: Series, rows: list[dict[str, Any]]) -> FootprintTransport:
    """Fit footprints with smooth light.

    Parameters
    ----------
    series : Series
        Pictures for which `unfit_for_footprints` is empty.
    rows : list of dict
        The transport's table of levels.
    """
    camera, projector = RayDomain(series.camera_shape), RayDomain(series.projector_shape)
    lit, radiance, variance = _floodlit_and_probes(series)
    light = float(np.abs(radiance[0].sum(axis=0)).mean())
    unit = float(2.0 ** np.round(np.log2(light))) if light > 0 else 1.0

    def pictures_of(chosen: slice) -> tuple[ViewArrays]:
        observed = radiance[:, chosen].sum(axis=1) / unit
        spread = np.where(series.known, variance[:, chosen].sum(axis=1) / unit**2, np.inf)
        return (ViewArrays(lit, _by_pixel(observed), _by_pixel(spread)),)

    count = series.channels
    channels = [pictures_of(slice(index, index + 1)) for index in range(count)] if count > 1 else []
    grey = pictures_of(slice(None))
    model = fit_model(camera, projector, grey, channels, limits=_LIMITS)
    pictures = [view for (view,) in channels or [grey]]
    indirect = [
        next(channel.indirect.in_pictures([view]))[:]
        for channel, view in zip(model.channels, pictures, strict=True)
    ]
    brightest = int(np.argmax([view.floodlit.sum() for view in pictures]))
    surfaces = surfaces_of(model.grey[0], camera, projector)
    boxes = expected_boxes(
        surfaces,
        model.channels[brightest].footprints[0],
        projector,
        pictures[brightest],
        indirect[brightest],
    )
    smooth = []
    for view, in_view, channel in zip(pictures, indirect, model.channels, strict=True):
        footprints = smoothed(view, channel.footprints[0], in_view, boxes)
        smooth.append(ChannelModel(StoredCandidates.of([footprints]), channel.indirect))
    arrays = transport_arrays(replace(model, channels=tuple(smooth)), unit)
    transport = FootprintTransport(camera.shape, projector.shape, count, rows, arrays)
    return _without_negative_light(transport, projector)


def _floodlit_and_probes(series: Series) -> tuple[Float, Float, Float]:
    """Compute a floodlit picture, and put the pictures of non-constant patterns behind it.

    Returns
    -------
    tuple of ndarray
        Patterns (N, K), radiance and its variance (K, C, M).
    """
    patterns = series.patterns[:, 0]
    white = _white_weights(patterns)
    assert white is not None
    is_probe = patterns.min(axis=1) < patterns.max(axis=1)
    floodlight = (white @ patterns)[None].astype(np.float32)
    lit = np.ascontiguousarray(np.vstack([floodlight, patterns[is_probe]]).T)
    radiance, variance = (
        np.concatenate([np.einsum("k,kcm->cm", weights, images)[None], images[is_probe]])
        for weights, images in (
            (white, np.where(series.known, series.radiance, 0)),
            (np.square(white), np.where(series.known, series.variance, 0)),
        )
    )
    return lit, radiance, variance


def _without_negative_light(
    transport: FootprintTransport, projector: RayDomain
) -> FootprintTransport:
    """Mix smooth light with even light, in the least proportion that leaves no square negative.

    The squares consist of projector rays, 16 squares along the longer side. Even light has the
    same total and comes equally from all rays.
    """
    _, square = projector.square_cells(-(-max(projector.image_shape) // _SQUARES))
    squares = np.zeros((int(square.max()) + 1, 1, projector.size), np.float32)
    squares[square, 0, np.arange(projector.size)] = 1
    count, direct = transport.channels, transport.direct()
    even_light = transport.mixed_with_even_light([0] * count, [1] * count)
    shares, strengths = [], []
    for channel in range(count):
        footprints = direct.forward(squares, [channel])[:, 0]
        smooth = transport.forward(squares, [channel])[:, 0] - footprints
        even = even_light.forward(squares, [channel])[:, 0] - footprints
        strength = max(float(smooth.sum(dtype=np.float64)), 0.0)
        strength /= max(float(even.sum(dtype=np.float64)), 1e-30)
        even *= np.float32(strength)
        is_negative = smooth < -_ROUNDING * float(even.max(initial=0))
        needed = np.divide(-smooth, even - smooth, out=np.zeros_like(smooth), where=is_negative)
        shares.append(float(needed.max(initial=0)))
        strengths.append(strength)
    if not any(shares):
        return transport
    return transport.mixed_with_even_light(
        [1 - share for share in shares],
        [share * strength for share, strength in zip(shares, strengths, strict=True)],
    )


def _by_pixel(pictures: NDArray[np.floating]) -> Float:
    """Return pictures (K, M) as (M, K)."""
    return np.ascontiguousarray(pictures.T, np.float32)


def _white_weights(patterns: Float) -> NDArray[np.float64] | None:
    """Return weights (K,) with which patterns (K, N) add up to white; None if they can't.

    ``a = argmin |P^T a - 1|^2 / N + ridge |a|^2``, which averages alternative combinations.
    """
    rows = patterns.astype(np.float64)
    rays = rows.shape[1]
    gram = rows @ rows.T / rays
    ridge = _RIDGE * float(np.trace(gram)) / len(rows)
    weights = np.linalg.solve(gram + ridge * np.eye(len(rows)), rows.sum(axis=1) / rays)
    total = weights @ rows
    weights /= total.mean()
    uneven = float(np.std(total / total.mean()))
    return weights if uneven < _MOST_UNEVEN else None
