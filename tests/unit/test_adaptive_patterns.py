"""The patterns of near/far acquisition: of every size of detail, along bands, and in strips."""

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.footprints.patterns import view_patterns
from rfpipe.methods.near_far.model import LightRange
from rfpipe.methods.near_far.patterns import probe_patterns
from rfpipe.methods.residual.model import cells_of
from rfpipe.methods.residual.patterns import block_patterns

SHAPE = (32, 40)
CREASE = np.abs(np.arange(40) - 19.5)


def crease(shape: tuple[int, int] = SHAPE) -> LightRange:
    """Light between two planes that meet in the middle column, the nearer the stronger."""
    distance = np.broadcast_to(CREASE, shape).astype(np.float32)
    across = np.where(np.arange(40) < 20, 1, -1) * np.ones(shape)
    return LightRange(
        np.maximum(distance, 0.5),
        1 / (1 + distance),
        np.zeros(shape, np.float32),
        across.astype(np.float32),
    )


@pytest.mark.parametrize("shape", [(7, 9), (2, 6, 5), (1, 16)])
def test_half_of_the_rays_are_lit(shape: tuple[int, ...]) -> None:
    patterns = probe_patterns(shape, 1, 5)
    assert patterns.dtype == np.bool_
    assert patterns.shape == (5, *shape)
    rays = int(np.prod(shape))
    assert patterns.reshape(5, -1).sum(axis=1).tolist() == [rays // 2] * 5


def test_a_pattern_follows_from_its_level_and_number_alone() -> None:
    few, many = (probe_patterns(SHAPE, 3, count) for count in (2, 6))
    np.testing.assert_array_equal(many[:2], few)
    flat = [pattern.tobytes() for level in (3, 4) for pattern in probe_patterns(SHAPE, level, 6)]
    assert len(set(flat)) == 12


def test_bands_of_equal_range_are_lit_together() -> None:
    bands = probe_patterns(SHAPE, 2, 40, crease())
    noise = probe_patterns(SHAPE, 2, 40)
    probes = np.arange(40) % 4 > 0

    def alike(patterns: np.ndarray) -> float:
        """How much of the variance is between columns, which have one range each."""
        return float(patterns[probes].mean(axis=1).var(axis=1).mean() / 0.25)

    assert alike(bands) > 2 * alike(noise)
    assert (bands[probes].mean(axis=(1, 2)) == 0.5).all()


@pytest.mark.parametrize("shape", [(48, 48), (2, 13, 31), (1, 5), (200, 220)])
def test_blocks_are_of_cells_and_of_one_size_a_pattern(shape: tuple[int, ...]) -> None:
    cells = cells_of(shape)
    found = block_patterns(cells, 9, 8)
    assert found.shape == (8, *shape)
    for pattern in found.reshape(8, -1):
        # all pixels of a cell are lit or none
        for lit in (pattern, ~pattern):
            assert not np.intersect1d(cells.of_ray[lit], cells.of_ray[~lit]).size
    np.testing.assert_array_equal(found, block_patterns(cells, 9, 8))
    if min(RayDomain(shape).image_shape) > 20:
        assert 0.2 < found.mean() < 0.4
        edges = (found[:, :, 1:] != found[:, :, :-1]).mean(axis=(1, 2))
        assert (np.diff(edges[:4]) < 0).all()


def test_views_are_lit_one_at_a_time_first_all_of_each() -> None:
    shown = view_patterns((3, 10, 12), 1, 9).reshape(9, 3, -1)
    lit = shown.any(axis=2)
    assert (lit.sum(axis=1) == 1).all()
    assert [int(each.argmax()) for each in lit] == [0, 1, 2] * 3
    assert (shown.sum(axis=(1, 2)) == [120] * 3 + [60] * 6).all()
