"""Random patterns of the adaptive methods."""

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.patterns import view_patterns
from rfpipe.methods.near_far.model import LightRange
from rfpipe.methods.near_far.patterns import probe_patterns
from rfpipe.methods.residual.model import residual_cells
from rfpipe.methods.residual.patterns import block_patterns

SHAPE = (32, 40)
DISTANCE_TO_CREASE = np.abs(np.arange(40) - 19.5)


def crease(shape: tuple[int, int] = SHAPE) -> LightRange:
    """Return the ranges of light between two planes that meet in the middle column."""
    distance = np.broadcast_to(DISTANCE_TO_CREASE, shape).astype(np.float32)
    across = np.where(np.arange(40) < 20, 1, -1) * np.ones(shape)
    return LightRange(
        np.maximum(distance, 0.5),
        1 / (1 + distance),
        np.zeros(shape, np.float32),
        across.astype(np.float32),
    )


@pytest.mark.parametrize("shape", [(7, 9), (2, 6, 5), (1, 16)])
def test_probes_light_two_fifths_of_the_rays(shape: tuple[int, ...]) -> None:
    patterns = probe_patterns(shape, 1, 5)
    assert patterns.dtype == np.bool_
    assert patterns.shape == (5, *shape)
    rays = int(np.prod(shape))
    assert patterns.reshape(5, -1).sum(axis=1).tolist() == [round(0.4 * rays)] * 5


def test_a_probe_depends_on_its_round_and_index_alone() -> None:
    two, six = (probe_patterns(SHAPE, 3, count) for count in (2, 6))
    np.testing.assert_array_equal(six[:2], two)
    patterns = [pattern.tobytes() for key in (3, 4) for pattern in probe_patterns(SHAPE, key, 6)]
    assert len(set(patterns)) == 12


def test_probes_light_bands_of_equal_range_together() -> None:
    bands = probe_patterns(SHAPE, 2, 40, crease())
    noise = probe_patterns(SHAPE, 2, 40)
    is_band = np.arange(40) % 4 > 0

    def variance_between_columns(patterns: np.ndarray) -> float:
        """Return the fraction of variance between columns; each column has one range."""
        return float(patterns[is_band].mean(axis=1).var(axis=1).mean() / (0.4 * 0.6))

    assert variance_between_columns(bands) > 2 * variance_between_columns(noise)
    assert (bands[is_band].mean(axis=(1, 2)) == 0.4).all()


@pytest.mark.parametrize("shape", [(48, 48), (2, 13, 31), (1, 5), (200, 220)])
def test_blocks_consist_of_cells_and_have_one_size_per_pattern(shape: tuple[int, ...]) -> None:
    cells = residual_cells(shape)
    patterns = block_patterns(cells, 9, 8)
    assert patterns.shape == (8, *shape)
    for pattern in patterns.reshape(8, -1):
        # no cell has both lit and dark pixels
        for lit in (pattern, ~pattern):
            assert not np.intersect1d(cells.of_ray[lit], cells.of_ray[~lit]).size
    np.testing.assert_array_equal(patterns, block_patterns(cells, 9, 8))
    if min(RayDomain(shape).image_shape) > 20:
        assert 0.2 < patterns.mean() < 0.4
        edges = (patterns[:, :, 1:] != patterns[:, :, :-1]).mean(axis=(1, 2))
        assert (np.diff(edges[:4]) < 0).all()


def test_views_are_lit_in_turn_after_a_floodlit_pattern_of_each_view() -> None:
    patterns = view_patterns((3, 10, 12), 1, 9).reshape(9, 3, -1)
    lit_views = patterns.any(axis=2)
    assert (lit_views.sum(axis=1) == 1).all()
    assert [int(views.argmax()) for views in lit_views] == [0, 1, 2] * 3
    assert (patterns.sum(axis=(1, 2)) == [120] * 3 + [60] * 6).all()
