"""Conflict graphs, their squares and their colouring."""

import numpy as np
import pytest
from scipy.sparse import coo_array

from rfpipe import conflicts
from rfpipe.conflicts import colour_columns, colour_square, conflict_graph, square


def graph_of(n_blocks: int, *edges: tuple[int, int]):
    first, second = np.array(edges, np.int64).reshape(-1, 2).T
    return conflict_graph(n_blocks, first, second)


def seen_in_pairs(n_blocks: int, *edges: tuple[int, int]):
    """Return a matrix with one row per edge, with entries at its two blocks."""
    first, second = np.array(edges, np.int64).reshape(-1, 2).T
    rows = np.tile(np.arange(len(first)), 2)
    ones = np.ones(2 * len(first), np.bool_)
    pair_graph = (rows, np.concatenate([first, second]))
    return coo_array((ones, pair_graph), shape=(len(first), n_blocks)).tocsr()


@pytest.fixture(params=[2**22, 0], ids=["edges", "no edges"])
def either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Colour by both algorithms: with and without a list of all edges."""
    monkeypatch.setattr(conflicts, "_MOST_EDGES", request.param)


@pytest.mark.usefixtures("either_way")
def test_a_complete_graph_needs_a_colour_for_each_block() -> None:
    edges = [(i, j) for i in range(7) for j in range(i)]
    assert sorted(colour_columns(seen_in_pairs(7, *edges)).tolist()) == list(range(7))
    assert sorted(colour_square(graph_of(7, *edges)).tolist()) == list(range(7))


@pytest.mark.usefixtures("either_way")
@pytest.mark.parametrize(("n_blocks", "colours"), [(0, []), (1, [0]), (3, [0, 0, 0])])
def test_blocks_without_conflicts_share_one_colour(n_blocks: int, colours: list[int]) -> None:
    assert colour_columns(seen_in_pairs(n_blocks)).tolist() == colours
    assert colour_square(graph_of(n_blocks)).tolist() == colours


@pytest.mark.usefixtures("either_way")
def test_a_star_needs_a_colour_for_each_of_its_blocks() -> None:
    """The block in the middle conflicts with all others."""
    star = [(0, block) for block in range(1, 6)]
    assert sorted(colour_square(graph_of(6, *star)).tolist()) == list(range(6))
    assert colour_columns(seen_in_pairs(6, *star)).max() + 1 == 2


@pytest.mark.usefixtures("either_way")
def test_colouring_is_the_same_every_time() -> None:
    random = np.random.default_rng(0)
    edges = random.integers(0, 60, (400, 2))
    first = colour_square(conflict_graph(60, *edges.T))
    np.testing.assert_array_equal(first, colour_square(conflict_graph(60, *edges.T)))
    np.testing.assert_array_equal(first, colour_square(conflict_graph(60, *edges[::-1].T)))


def test_colours_of_large_graphs_are_near_those_of_small_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Blocks of a plane with conflicts at distances up to four, as by interreflections."""
    at = np.indices((24, 24)).reshape(2, -1)
    near = np.hypot(*(at[:, :, None] - at[:, None])) <= 4
    graph = conflict_graph(len(near), *np.nonzero(near))
    by_library = colour_square(graph)
    monkeypatch.setattr(conflicts, "_MOST_EDGES", 0)
    result = colour_square(graph)
    row, column = square(graph).nonzero()
    assert (result[row] != result[column]).all()
    assert result.max() <= 1.02 * by_library.max()
