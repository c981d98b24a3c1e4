"""Exposures of a bracket that add nothing: pictures without them would hardly be noisier.

With the exposures i of a set, light of the radiance L has the variance (`merge_bracket`)

    v(L) = 1 / sum_i w_i k_i,    w_i = k_i / (k_i L + n_i),    where exposure i isn't saturated

======  ====================  ======================================================================
symbol  name in the code      meaning and unit
======  ====================  ======================================================================
``k``   `collection`          electrons that a radiance of 1 gives in the exposure
``n``   `fixed_variance`      variance of all but the light's own shot noise, electrons squared
======  ====================  ======================================================================
"""

from __future__ import annotations

import numpy as np

from rfpipe.array_types import Double, Float
from rfpipe.photometry.camera import CameraModel
from rfpipe.units import SATURATION_FRACTION

_MOST_SAMPLES = 10_000

_SCALES = (1.0, 0.1, 0.01)
"""Brightness of the pictures, over that of the floodlit image: indirect light is far dimmer."""

_ACCEPTED = 1.05
"""Noise without an exposure, over the noise with all, up to which the exposure adds nothing."""


def needless_exposures(camera: CameraModel, floodlit: Float) -> tuple[float, ...]:
    """Find the exposures of a camera that add nothing in pictures of a scene.

    Parameters
    ----------
    camera : CameraModel
    floodlit : ndarray of float32
        Radiance under the all-on pattern.

    Returns
    -------
    tuple of float
        Exposure times in seconds. Without them, at no brightness is the noise more than 5 % larger,
        and no pixel more is saturated.
    """
    light = floodlit[floodlit > 0].astype(np.float64)
    if not light.size:
        return ()
    light = light[:: -(-light.size // _MOST_SAMPLES)]
    levels = np.multiply.outer(np.asarray(_SCALES), light)
    chosen = list(range(len(camera.exposures)))
    variance = _variance(camera, chosen, levels)
    while len(chosen) > 1:
        smaller = [[index for index in chosen if index != left_out] for left_out in chosen]
        growths = [_growth(_variance(camera, subset, levels), variance) for subset in smaller]
        best = int(np.argmin(growths))
        if growths[best] > _ACCEPTED**2:
            break
        chosen = smaller[best]
    return tuple(seconds for index, seconds in enumerate(camera.exposures) if index not in chosen)


def _variance(camera: CameraModel, exposures: list[int], levels: Double) -> Double:
    """Compute v of radiance `levels`; infinite where all `exposures` are saturated."""
    information = np.zeros_like(levels)
    for index in exposures:
        seconds = camera.exposures[index]
        collection = camera.electrons_per_radiance * seconds
        dark = camera.dark_current_electrons * seconds
        fixed_variance = camera.read_noise_electrons**2 + dark + camera.electrons_per_count**2 / 12
        electrons = collection * levels
        usable = electrons < SATURATION_FRACTION * camera.full_well_electrons
        information += np.where(usable, collection**2 / (electrons + fixed_variance), 0)
    return np.divide(1, information, out=np.full_like(levels, np.inf), where=information > 0)


def _growth(variance: Double, reference: Double) -> float:
    """Compute the largest growth of the noise of a picture, as a ratio of variances.

    Pixels that are saturated in the reference, too, don't count.
    """
    known = np.isfinite(reference)
    sums = [
        (of_level[is_known].sum(), reference_level[is_known].sum())
        for of_level, reference_level, is_known in zip(variance, reference, known, strict=True)
        if is_known.any()
    ]
    return max((float(total / before) for total, before in sums), default=1.0)
