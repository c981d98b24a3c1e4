"""The model of near/far acquisition, fitted to pictures of a coaxial rig."""

from __future__ import annotations

from typing import Any

import numpy as np

from rfpipe.fitting.series import Series
from rfpipe.methods.images import Pictures
from rfpipe.methods.near_far.fit import fit_smooth_model
from rfpipe.methods.near_far.model import near_far_transport
from rfpipe.methods.near_far.pictures import SplitPictures, fit_cells
from rfpipe.methods.residual.fit import fit_residual
from rfpipe.methods.residual.model import CameraCells, coaxial_projector
from rfpipe.methods.states import joined
from rfpipe.transport.base import Transport


def unfit_for_near_far(series: Series) -> str:
    """Return why the model of coaxial rigs can't be fitted to pictures, or an empty string."""
    patterns, white = series.patterns, series.patterns.all(axis=-1)
    if series.camera_shape != series.projector_shape:
        return (
            f"a coaxial rig has one shape of rays, not {series.camera_shape} camera and "
            f"{series.projector_shape} projector rays"
        )
    are_binary = patterns.shape[1] == 1 and ((patterns == 0) | (patterns == 1)).all()
    if not are_binary or not white.any() or white.all():
        return (
            "the model of coaxial rigs needs a picture of white light, and others of patterns "
            "whose weights are 0 or 1; add them, or leave out --coaxial"
        )
    return ""


def solve_near_far(series: Series, rows: list[dict[str, Any]]) -> Transport:
    """Fit direct light, smooth indirect light, and the residual of both.

    Parameters
    ----------
    series : Series
        Pictures for which `unfit_for_near_far` is empty.
    rows : list of dict
        The transport's table of levels.
    """
    shape, lit = series.projector_shape, series.patterns[:, 0] > 0
    white = lit.all(axis=1)
    radiance = series.radiance[white].mean(axis=0, dtype=np.float64)[None].astype(np.float32)
    spread = series.variance[white].mean(axis=0, dtype=np.float64)[None] / np.count_nonzero(white)
    floodlit = Pictures(lit[white][:1], radiance, spread.astype(np.float32)).with_masked_filled(
        shape
    )
    probes = Pictures(lit[~white], series.radiance[~white], series.variance[~white])
    cells = fit_cells(shape)
    model = fit_smooth_model(cells, floodlit, SplitPictures.of(cells, floodlit, probes))
    camera = CameraCells.of_pictures(shape, floodlit)
    samples = joined(
        [camera.cell_pictures(it.lit, it.radiance, it.variance) for it in (floodlit, probes)],
        axis=0,
    )
    smooth = near_far_transport(shape, [], model, floodlit)
    residual = fit_residual(camera, coaxial_projector(camera), samples, smooth)
    return near_far_transport(shape, rows, model, floodlit, [residual.transport(camera, shape)])
