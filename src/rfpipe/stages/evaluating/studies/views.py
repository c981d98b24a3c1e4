"""An 8D field: 3 x 3 coaxial views of a physically based scene [thesis Fig. 5.8]."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.evaluating.studies.physical import (
    Arrays,
    Rows,
    acquired,
    cost,
    matte,
    physical_scene,
)

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["views_study"]

Float = NDArray[np.float32]

_SHARE = 3  # of the figures' side: there are 9 x 9 pairs of views
_LEAST = 12  # pixels a view's side
_TOLERANCE = 3e-3  # below it noise of so few paths of light is subdivided
_PERIOD = 4  # pixels, of the matte


def views_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire an array of 3 x 3 coaxial views by symmetric photography [Fig. 5.8].

    Returns
    -------
    rows : list of dict
        A row of Table 5.1; ``grid`` of the views; ``tolerance``; ``errors``, a list a light of
        the relative RMS errors of all views; ``light_moves`` and ``view_moves``: the least
        relative difference of another light's, or view's, picture from the middle one's, true
        ones; ``matte_error``: of the middle view in the matte of a corner's projector.
    arrays : dict of ndarray
        Float32 (lights, views, H, W, 3): ``views_relit`` and ``views_truth``; (H, W, 3): ``matte``
        and ``matte_truth``, the middle view in the first projector's matte; ``pattern`` (H, W).
    """
    from rfpipe.config.figures import FiguresConfig

    asked = config.report.figures or FiguresConfig()
    side = max(_LEAST, asked.side // _SHARE)
    scene = physical_scene(config, "views_3x3", shape=(side, side))
    result, _ = acquired(config, scene, "symmetric", tolerance=_TOLERANCE)
    count = scene.projector_shape[0]
    lights = np.zeros((count + 1, *scene.projector_shape), np.float32)
    lights[range(count), range(count)] = 1
    lights[count, 0] = matte(scene.projector_shape, _PERIOD)[0]
    relit = result.transport.relight_batch(lights)
    truth = scene.apply(lights.reshape(len(lights), -1)).reshape(relit.shape)
    middle = count // 2
    arrays: Arrays = {
        "views_relit": relit[:count],
        "views_truth": truth[:count],
        "matte": relit[count, middle],
        "matte_truth": truth[count, middle],
        "pattern": lights[count, 0],
    }
    errors = [
        [relative_rms(*pictures) for pictures in zip(*of_light, strict=True)]
        for of_light in zip(relit[:count], truth[:count], strict=True)
    ]
    row = cost(
        "5.1",
        "Fig. 5.8, 8D",
        scene,
        result,
        (relit[:count], truth[:count]),
        grid=[int(np.sqrt(count))] * 2,
        tolerance=_TOLERANCE,
        errors=errors,
        light_moves=_least_change(truth[:count, middle]),
        view_moves=_least_change(truth[middle]),
        matte_error=relative_rms(arrays["matte"], arrays["matte_truth"]),
    )
    return [row], arrays


def _least_change(pictures: Float) -> float:
    """Return the least relative difference of a picture from the middle one."""
    middle = len(pictures) // 2
    others = np.delete(pictures, middle, axis=0)
    return min(relative_rms(picture, pictures[middle]) for picture in others)
