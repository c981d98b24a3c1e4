"""The walk-through of [thesis Fig. 3.1]: the counts and blocks that its caption fixes."""

import json

import numpy as np
import pytest
from tests.golden.make_fig_3_1 import (
    BLOCK_6,
    BLOCK_8,
    BLOCK_9,
    BLOCK_10,
    BLOCK_12,
    GOLDEN,
    shown,
)


def block_of(ray: tuple[int, int], size: int) -> tuple[slice, slice]:
    """The block of a size that holds a ray."""
    row, column = ray[0] // size * size, ray[1] // size * size
    return slice(row, row + size), slice(column, column + size)


def patterns_in(level: np.ndarray, ray: tuple[int, int], size: int) -> set[int]:
    return set(level[block_of(ray, size)].ravel().tolist())


@pytest.fixture(scope="module")
def levels() -> list[np.ndarray]:
    return [np.array(level) for level in shown(conflicts=True)]


@pytest.mark.parametrize("case", ["without_conflicts", "with_conflicts"])
def test_patterns_are_the_golden_ones(case: str) -> None:
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))[case]
    assert shown(case == "with_conflicts") == golden


def test_thirteen_patterns_without_conflicts() -> None:
    counts = [np.max(level) + 1 for level in shown(conflicts=False)]
    assert counts == [1, 4, 4, 4]  # 4 log4(pq) + 1 in all


def test_twenty_one_patterns_with_the_conflicts_drawn(levels: list[np.ndarray]) -> None:
    assert [int(level.max()) + 1 for level in levels] == [1, 4, 8, 8]


def test_level_two_lights_one_quadrant_after_the_other(levels: list[np.ndarray]) -> None:
    quadrants = [patterns_in(levels[1], corner, 4) for corner in ((0, 0), (0, 4), (4, 0), (4, 4))]
    assert sorted(quadrants, key=min) == [{0}, {1}, {2}, {3}]


def test_level_three_keeps_the_children_of_blocks_2_and_4_apart(levels: list[np.ndarray]) -> None:
    of_block_2 = patterns_in(levels[2], BLOCK_6, 4)
    of_block_4 = patterns_in(levels[2], BLOCK_12, 4)
    assert len(of_block_2) == len(of_block_4) == 4
    assert of_block_2.isdisjoint(of_block_4)
    # Blocks 3 and 5 conflict with nobody: they go along with one of the two.
    for corner in ((0, 4), (4, 0)):
        assert patterns_in(levels[2], corner, 4) in (of_block_2, of_block_4)


@pytest.mark.parametrize(("one", "other"), [(BLOCK_6, BLOCK_12), (BLOCK_8, BLOCK_10)])
def test_level_four_keeps_the_children_of_conflicting_blocks_apart(
    levels: list[np.ndarray], one: tuple[int, int], other: tuple[int, int]
) -> None:
    assert patterns_in(levels[3], one, 2).isdisjoint(patterns_in(levels[3], other, 2))


def test_block_9_is_lit_until_it_measures_nothing(levels: list[np.ndarray]) -> None:
    assert (levels[2][block_of(BLOCK_9, 2)] >= 0).all()
    assert (levels[3][block_of(BLOCK_9, 2)] == -1).all()
    assert int((levels[3] == -1).sum()) == 4  # and nothing else is dark
