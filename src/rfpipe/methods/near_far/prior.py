"""Floodlit picture and indirect light of a prior in the near/far model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rfpipe.array_types import Float
from rfpipe.methods.images import Pictures, relight_white
from rfpipe.transport.base import Transport

# Standard deviations up to which a pixel's difference from the prior counts as noise.
_UNCHANGED = 2.0


def denoised_floodlit(floodlit: Pictures, prior: Transport) -> Pictures:
    """Replace the noise of a floodlit picture by the prior's where both agree.

    The prior's floodlit image is scaled to the mean of the picture over 5 x 5 pixels. A pixel that
    differs from it by d, with a standard deviation s, becomes this expected value plus
    ``d max(1 - (2 s / d)^2, 0)``.
    """
    expected = relight_white(prior, floodlit.lit)
    shape = prior.camera_shape
    expected *= _ratio(_smooth(floodlit.radiance, shape, 5), _smooth(expected, shape, 5))
    difference = floodlit.radiance - expected
    excess = np.maximum(np.square(difference) - _UNCHANGED**2 * floodlit.variance, 0)
    return replace(floodlit, radiance=expected + _ratio(excess, difference))


def _ratio(numerator: Float, denominator: Float) -> Float:
    """Divide; 0 where the denominator is 0."""
    zero = np.zeros_like(numerator)
    return np.divide(numerator, denominator, out=zero, where=denominator != 0)


def _smooth(images: Float, shape: tuple[int, ...], width: int) -> Float:
    """Average images (..., rays) over squares of `width` pixels."""
    from scipy.ndimage import uniform_filter

    stacks = images.reshape(*images.shape[:-1], *shape)
    return uniform_filter(stacks, width, axes=(-2, -1)).reshape(images.shape)


def without_indirect_light(pictures: Pictures, prior: Transport) -> Pictures:
    """Subtract the indirect light of a prior T from pictures, c + (T 1) p - T p.

    Entries of its diagonal cancel: the pictures of a coaxial rig keep their direct light.
    """
    floodlit = relight_white(prior, np.ones_like(pictures.lit[:1]))
    indirect = relight_white(prior, pictures.lit) - floodlit * pictures.lit[:, None]
    return replace(pictures, radiance=pictures.radiance - indirect)
