"""Relit images next to the truth, and the map of leaf levels along a line."""

import numpy as np
import pytest

from rfpipe.config import SceneSettings
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import (
    relighting_patterns,
    scene_from_config,
)
from rfpipe.stages.acquire import acquire
from rfpipe.stages.evaluate import relative_rms
from rfpipe.stages.relight import NO_LEAF, leaf_levels, relit_arrays
from rfpipe.transport import Transport

SCENE = SceneSettings.of("wedge", surfaces=("white", "texture"), shape=(9, 12), channels=3)


@pytest.fixture(scope="module")
def transports() -> dict[str, Transport]:
    rig = SimulatedRig(scene_from_config(SCENE))
    methods = ("symmetric", "dual", "brute_force", "hadamard")
    return {method: acquire(rig, method, progress=False).transport for method in methods}


@pytest.mark.parametrize("method", ["symmetric", "dual", "brute_force", "hadamard"])
def test_all_images_agree_with_the_scenes_matrix(transports, method):
    scene = scene_from_config(SCENE)
    arrays = relit_arrays(transports[method], scene)
    patterns = relighting_patterns(scene.shape)
    assert np.array_equal(arrays["patterns"], np.stack(list(patterns.values())))
    matrix = np.stack([scene.dense(channel) for channel in range(3)], axis=-1)
    for image, pattern in zip(arrays["truth"], arrays["patterns"], strict=True):
        expected = np.einsum("mnc,n->mc", matrix, pattern.ravel()).reshape(image.shape)
        np.testing.assert_allclose(image, expected, rtol=1e-5)
    line = slice(4 * 12, 5 * 12)  # row 4 of 9
    np.testing.assert_allclose(arrays["line_truth"], matrix[line, line], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(arrays["half_truth"], arrays["half_relit"], atol=2e-2)
    assert relative_rms(arrays["relit"], arrays["truth"]) < 0.05
    assert relative_rms(arrays["line_relit"], arrays["line_truth"]) < 0.05
    np.testing.assert_allclose(arrays["levels_relit"][-1], arrays["relit"][0], atol=1e-6)
    assert len(arrays["levels_relit"]) == len(transports[method].known_levels)
    assert all(np.isfinite(array).all() for array in arrays.values())


@pytest.mark.parametrize("method", ["symmetric", "dual"])
@pytest.mark.parametrize("row", [0, 4, 8])
def test_the_level_map_has_the_level_of_each_entry(transports, method, row):
    transport = transports[method]
    levels = leaf_levels(transport, row, row)
    rays = slice(row * 12, (row + 1) * 12)
    impulses = np.eye(108, dtype=np.float32).reshape(108, 9, 12)[rays]
    entries = transport.relight_batch(impulses)[:, row].swapaxes(0, 1).max(axis=-1)
    assert (entries[levels == NO_LEAF] == 0).all()
    assert (levels >= 0).sum() >= (entries > 0).sum()
    stored = {int(name.split("_")[1]) for name in transport.pack()[0]}
    assert set(np.unique(levels)) - {NO_LEAF} <= stored
    # An entry stays at its level when the transport is truncated later, or moves up.
    stopped = leaf_levels(transport.truncate(2), row, row)
    assert (stopped[(levels >= 0) & (levels < 2)] == levels[(levels >= 0) & (levels < 2)]).all()
    assert (stopped[levels >= 2] == 2).all()


def test_a_transport_without_leaves_has_no_level_map(transports):
    assert leaf_levels(transports["brute_force"], 4, 4) is None
