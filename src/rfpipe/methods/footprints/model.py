"""The footprint model of all channels.

Each of the C channels has its own arrays, except L and R:

    T = D + diag(f) L S R^T diag(g)

======  ==================================  ======  ================================================
symbol  name in the code                    shape   meaning and unit
======  ==================================  ======  ================================================
``T``   `FootprintTransport`                (M, N)  light transport, radiance
``D``   `ChannelModel.footprints`           (M, N)  direct light, sparse, radiance
``L``   `IndirectBasis.L`                   (M, n)  functions over camera rays, sparse, no unit
``R``   `IndirectBasis.R`                   (N, n)  functions over projector rays, sparse, no unit
``S``   `IndirectLight.core_matrix()`       (n, n)  cores: light between functions, sparse, inverse
                                                    radiance
``f``   `IndirectLight.f`                   (M,)    scale factor of each camera ray, radiance
``g``   `IndirectLight.g`                   (N,)    scale factor of each projector ray, radiance
======  ==================================  ======  ================================================

`rfpipe.methods.footprints.functions` defines L, R, f and g. The fit has its own unit of radiance;
`transport_arrays` converts D and f to the unit of the pictures. S and g keep the fit's, since S is
inverse to g.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float, Index
from rfpipe.methods.footprints.candidates import StoredCandidates
from rfpipe.methods.footprints.indirect import IndirectLight
from rfpipe.transport.footprints import sparse_arrays
from rfpipe.transport.hierarchical.leaves import ragged_ranges


@dataclass(frozen=True)
class ChannelModel:
    """Direct and indirect light of one channel."""

    footprints: StoredCandidates
    indirect: IndirectLight


@dataclass(frozen=True)
class FittedChannels:
    """Result of a fit: the footprints of the channels' sum, and the model of each channel.

    Attributes
    ----------
    grey : StoredCandidates
        Footprints of the channels' sum, the start of the next search.
    channels : tuple of ChannelModel
    """

    grey: StoredCandidates
    channels: tuple[ChannelModel, ...]


def transport_arrays(fitted: FittedChannels, unit: float) -> dict[str, NDArray[Any]]:
    """Return the arrays of a `FootprintTransport`; `unit` is the radiance of 1 in the fit."""
    lights = [channel.indirect for channel in fitted.channels]
    basis = lights[0].basis
    cores = [light.core_matrix() for light in lights]
    return {
        **footprint_arrays([channel.footprints for channel in fitted.channels], unit),
        **sparse_arrays("left", basis.L),
        **sparse_arrays("right", basis.R),
        **sparse_arrays("cores", cores[0], [S.data for S in cores]),
        "camera_factor": np.stack([light.f * np.float32(unit) for light in lights]),
        "projector_factor": np.stack([light.g for light in lights]),
    }


def footprint_arrays(channels: Sequence[StoredCandidates], unit: float) -> dict[str, NDArray[Any]]:
    """Join the footprints on all projector views, whose candidates all channels share.

    Candidates that are 0 in all channels are dropped. The views are read twice: to count their
    candidates, and to copy these.
    """
    size, views = channels[0].projector_size, range(len(channels[0]))

    def footprints_on(view: int) -> tuple[Index, NDArray[np.int32], Float]:
        """Return camera pixels (k,), columns of D (k,), and weights (C, k)."""
        candidates = [channel[view] for channel in channels]
        weights = np.stack([part.weights for part in candidates])
        lit = weights.any(axis=0)
        columns = candidates[0].projector_pixels[lit] + np.int32(view * size)
        return candidates[0].camera_pixels[lit], columns, weights[:, lit] * np.float32(unit)

    pixels = channels[0].camera_size
    counts = np.stack([np.bincount(footprints_on(v)[0], minlength=pixels) for v in views], axis=1)
    # the footprints of a camera pixel are in the order of views
    ends = np.cumsum(counts).reshape(counts.shape)
    columns = np.empty(int(counts.sum()), np.int32)
    weights = np.empty((len(channels), len(columns)), np.float32)
    for view in views:
        place = ragged_ranges(ends[:, view] - counts[:, view], counts[:, view])
        _, columns[place], weights[:, place] = footprints_on(view)
    starts = np.concatenate([[0], ends[:, -1]]).astype(np.int32)
    return {"footprints": weights, "footprints_columns": columns, "footprints_starts": starts}


def uniform_arrays(floodlit: Float, projector_size: int) -> dict[str, NDArray[Any]]:
    """Return the arrays of a `FootprintTransport` before any fit, from the floodlit image.

    Every projector ray contributes equally to every camera pixel. `floodlit` is the image of each
    channel, radiance, float32 (C, M).
    """
    from scipy.sparse import csr_array

    channels, camera_size = floodlit.shape
    no_footprints: Any = csr_array((camera_size, projector_size), dtype=np.float32)
    single_core: Any = csr_array(np.ones((1, 1), np.float32))
    share = np.full(1, 1 / projector_size, np.float32)
    return {
        **sparse_arrays("footprints", no_footprints, [no_footprints.data] * channels),
        **sparse_arrays("left", csr_array(np.ones((camera_size, 1), np.float32))),
        **sparse_arrays("right", csr_array(np.ones((projector_size, 1), np.float32))),
        **sparse_arrays("cores", single_core, [share] * channels),
        "camera_factor": np.maximum(floodlit, 0),
        "projector_factor": np.ones((channels, projector_size), np.float32),
    }
