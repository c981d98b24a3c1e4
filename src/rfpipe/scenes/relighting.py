"""Test patterns for comparing relit pictures with the ground truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.provenance import generator
from rfpipe.relighting import octave_noise

RELIGHTING_PATTERNS = ("vertical_bar", "horizontal_bar", "noise", "binary", "spot")

ONE_VIEW = "one_view"
"""Additional pattern of a stack of views: only the first view's projector is on."""

_SPOT = (3, 4)  # height and width in pixels


def relighting_patterns(shape: tuple[int, ...], seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Create the relighting patterns of a ray domain: float32 arrays of `shape`, in [0, 1].

    ``vertical_bar``: centred at W / 4, W / 8 wide. ``horizontal_bar``: from H / 3 to H / 2.
    ``noise``: uniform. ``binary``: a smooth random field, thresholded at its mean. ``spot``: 4
    pixels wide and 3 high, left of the centre. Each has at least one lit pixel. Several views have
    the same picture, and the additional pattern `ONE_VIEW`.

    Raises
    ------
    InputError
        If the shape isn't that of a ray domain.
    """
    domain = RayDomain(shape)
    height, width = domain.image_shape
    pictures = {name: np.zeros((height, width), dtype=np.float32) for name in RELIGHTING_PATTERNS}
    start = width // 4 - width // 16
    pictures["vertical_bar"][:, start : start + max(1, width // 8)] = 1
    top = height // 3
    pictures["horizontal_bar"][top : max(top + 1, height // 2)] = 1
    pictures["noise"][:] = generator(seed, 0).random((height, width), dtype=np.float32)
    smooth = octave_noise((height, width), generator(seed, 1), falloff=2.0)
    pictures["binary"][:] = smooth >= smooth.mean()
    row, column = height // 2, width // 5
    pictures["spot"][row : row + _SPOT[0], column : column + _SPOT[1]] = 1
    patterns = {
        name: np.ascontiguousarray(np.broadcast_to(picture, shape))
        for name, picture in pictures.items()
    }
    if domain.is_stack:
        patterns[ONE_VIEW] = np.zeros(shape, dtype=np.float32)
        patterns[ONE_VIEW].reshape(domain.stack_shape)[0] = 1
    return patterns
