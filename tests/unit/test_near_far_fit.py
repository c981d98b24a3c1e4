"""The fit of the near/far model."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rigs.known_matrix import scene_matrices

from rfpipe.methods.images import Pictures
from rfpipe.methods.near_far.fit import fit_smooth_model
from rfpipe.methods.near_far.model import near_far_transport
from rfpipe.methods.near_far.patterns import probe_patterns
from rfpipe.methods.near_far.pictures import SplitPictures
from rfpipe.transport.wavelet import Cells


@pytest.mark.parametrize(("side", "error"), [(1, 0.02), (2, 0.03)])
def test_each_channel_is_fitted_and_dark_channels_stay_dark(side: int, error: float) -> None:
    shape = (24, 24)
    matrix = scene_matrices("IV", shape, 3)
    matrix[2] = 0
    white = np.ones((1, *shape), bool)
    lit = np.concatenate([white, probe_patterns(shape, 1, 12)]).reshape(13, -1)
    radiance = np.einsum("mn,crn->mcr", lit, matrix).astype(np.float32)
    pictures = Pictures(lit, radiance, np.full_like(radiance, 1e-8))

    cells, floodlit = Cells(shape, side), pictures.select(slice(0, 1))
    split = SplitPictures.of(cells, floodlit, pictures.probes)
    model = fit_smooth_model(cells, floodlit, split)
    transport = near_far_transport(shape, [], model, floodlit)

    assert not model.cores[2].any()
    pattern = (np.arange(576) % 24 < 8).astype(np.float32)
    images = transport.forward(np.broadcast_to(pattern, (1, 3, 576)), range(3))[0]
    for image, expected in zip(images[:2], (matrix @ pattern)[:2], strict=True):
        assert np.linalg.norm(image - expected) < error * np.linalg.norm(expected)
