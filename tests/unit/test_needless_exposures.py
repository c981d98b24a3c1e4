"""Exposures that add nothing, by the noise of pictures merged without them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.references.needless_exposures import needless_exposures

EXPOSURES = CameraModel().exposures


def measured_noise(camera: CameraModel, scene: np.ndarray) -> float:
    """Measure the relative noise of merged pictures of a scene."""
    black = np.mean([camera.expose(0 * scene, 0, (index,)) for index in range(60)], axis=0)
    merge = camera.bracket_merge(black.astype(np.float32), 60)
    brackets = np.stack([camera.expose(scene, 1, (index,)) for index in range(60)])
    return float(np.sqrt(merge(brackets).radiance.var(axis=0, ddof=1).mean()))


@pytest.mark.parametrize(
    ("brightest", "electrons", "needless"),
    [
        (1.0, 640_000.0, ()),  # bright pixels need short exposures, dark ones the longest
        (1.0, 20_000.0, EXPOSURES[:2]),  # the longest exposure hardly saturates
        (0.02, 640_000.0, EXPOSURES[:2]),
    ],
)
def test_exposures_add_nothing_where_longer_ones_are_not_saturated(
    brightest: float, electrons: float, needless: tuple[float, ...]
) -> None:
    scene = (brightest * generator(5).uniform(0.05, 0.97, (20, 20, 1))).astype(np.float32)
    camera = CameraModel(electrons_per_radiance=electrons)
    found = needless_exposures(camera, scene)
    assert found == needless
    if found:
        fewer = replace(camera, exposures=tuple(t for t in EXPOSURES if t not in found))
        for scale in (1.0, 0.1):
            dim = np.float32(scale) * scene
            assert measured_noise(fewer, dim) < 1.08 * measured_noise(camera, dim)


def test_without_light_nothing_is_advised() -> None:
    assert needless_exposures(CameraModel(), np.zeros((4, 4, 1), np.float32)) == ()
