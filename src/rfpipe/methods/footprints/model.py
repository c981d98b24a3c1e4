"""The footprint model of all channels.

    T = D + diag(f) L S R^T diag(g)

======  =========================  ======  =========================================================
symbol  name in the code           shape   meaning and unit
======  =========================  ======  =========================================================
``T``   `FootprintTransport`       (M, N)  light transport of a channel, radiance
``D``   `ChannelModel.footprints`  (M, N)  direct light, sparse, radiance
``L``   `IndirectBasis.L`          (M, n)  functions over camera rays, no unit
``R``   `IndirectBasis.R`          (N, n)  functions over projector rays, no unit
``S``   `IndirectLight.cores`      (n, n)  light between functions, inverse radiance
``f``   `IndirectLight.f`          (M,)    indirect light received, radiance
``g``   `IndirectLight.g`          (N,)    indirect light sent, radiance
======  =========================  ======  =========================================================

M, N and n are the numbers of camera rays, of projector rays and of functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.methods.footprints.candidates import Candidates
from rfpipe.methods.footprints.indirect import IndirectLight
from rfpipe.transport.footprints import sparse_arrays


@dataclass(frozen=True)
class ChannelModel:
    """Direct and indirect light of one channel."""

    footprints: Candidates
    indirect: IndirectLight


@dataclass(frozen=True)
class FootprintModel:
    """Model of all channels.

    Attributes
    ----------
    grey : Candidates
        Footprints of the channels' sum, the starting point of the next search.
    channels : tuple of ChannelModel
    """

    grey: Candidates
    channels: tuple[ChannelModel, ...]


def transport_arrays(model: FootprintModel, unit: float) -> dict[str, NDArray[Any]]:
    """Return the arrays of a `FootprintTransport`; `unit` is the radiance of 1 in the model."""
    lights = [channel.indirect for channel in model.channels]
    basis = lights[0].basis
    direct = [channel.footprints.matrix() for channel in model.channels]
    cores = [basis.core_matrix(light.cores) for light in lights]
    return {
        **sparse_arrays("footprints", direct[0], [D.data * np.float32(unit) for D in direct]),
        **sparse_arrays("left", basis.L),
        **sparse_arrays("right", basis.R),
        **sparse_arrays("cores", cores[0], [S.data for S in cores]),
        "camera_factor": np.stack([light.f * np.float32(unit) for light in lights]),
        "projector_factor": np.stack([light.g for light in lights]),
    }
