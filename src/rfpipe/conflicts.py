"""Conflict graphs and their colouring (thesis §3.1, §5.1, Lemmas 1 and 2)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

__all__ = ["colour_apart", "colour_seen", "conflict_graph", "square"]

Colours = NDArray[np.int32]
_Edges = tuple[NDArray[np.integer], NDArray[np.integer]]

# Edges go to rustworkx as Python numbers, 100 bytes each: not all of them at a time. It keeps them
# in 24 bytes each, and takes a second for a million: graphs of more are never written out.
_ROWS_AT_A_TIME = 1024
_MOST_EDGES = 2**22
# They are coloured again, in other orders, until so many orders in a row save no colour.
_IN_VAIN = 3


def conflict_graph(
    n_blocks: int, first: NDArray[np.integer], second: NDArray[np.integer]
) -> csr_array:
    """Return the symmetric adjacency of the blocks' conflicts.

    Parameters
    ----------
    n_blocks : int
    first, second : ndarray of int, shape (E,)
        The two blocks of each conflict; repeats and self-conflicts are allowed and drop out.

    Returns
    -------
    csr_array of bool, shape (n_blocks, n_blocks)
        True where two different blocks conflict.
    """
    from scipy.sparse import coo_array

    joined = coo_array(
        (np.ones(len(first), np.bool_), (first, second)), shape=(n_blocks, n_blocks)
    ).tocsr()
    joined.setdiag(False)
    joined.eliminate_zeros()
    graph: csr_array = (joined + joined.T).tocsr()
    return graph


def square(graph: csr_array, rows: slice = slice(None)) -> csr_array:
    """Return the square of a graph: an edge between blocks at most two edges apart [Har01].

    Two blocks that are not joined in the square of the graph of unknown transport can be lit
    together (Block Scheduling Lemma, thesis §5.1).

    Parameters
    ----------
    graph : csr_array of bool, shape (n, n)
    rows : slice
        Which of its rows to return.

    Returns
    -------
    csr_array of bool, shape (rows, n)
        True where two different blocks are joined.
    """
    squared: csr_array = (graph[rows] + graph[rows] @ graph).tocsr()
    squared.setdiag(False, k=rows.start or 0)
    squared.eliminate_zeros()
    return squared


def colour_apart(graph: csr_array) -> Colours:
    """Colour blocks so that those at most two edges apart differ; see `colour_seen`.

    Parameters
    ----------
    graph : csr_array of bool, shape (n, n)
        Symmetric adjacency without self-loops. Its square is never held as a whole.

    Returns
    -------
    ndarray of int32, shape (n,)
        Colours 0, 1, ...; deterministic for a given graph.
    """
    from scipy.sparse import eye_array

    # a block's row holds itself and its neighbours, any two of which are at most two edges apart
    near = (graph + eye_array(graph.shape[0], dtype=graph.dtype, format="csr")).tocsr()
    return _coloured(near.T, near, lambda rows: square(graph, rows))


def colour_seen(sees: csr_array) -> Colours:
    """Colour blocks so that nobody sees two of one colour.

    Graphs of up to some million edges are coloured by a library's two greedy heuristics, of which
    the fewer colours count. The edges of larger ones are never written out: that two blocks are
    joined is read off those who see both.

    Parameters
    ----------
    sees : csr_array, shape (m, n)
        Not zero where the row's pixel sees the column's block.

    Returns
    -------
    ndarray of int32, shape (n,)
        Colours 0, 1, ...; deterministic for a given matrix.
    """
    by_block = sees.T.tocsr().astype(np.int32)
    both = sees.tocsr().astype(np.int32)

    def joined(rows: slice) -> csr_array:
        together: csr_array = by_block[rows] @ both
        together.sort_indices()
        return together

    return _coloured(sees.tocsc(), sees.tocsr(), joined)


def _coloured(sees: csc_array, by_row: csr_array, joined: Callable[[slice], csr_array]) -> Colours:
    """Colour the columns; `joined` gives rows of the adjacency, of which the diagonal is left."""
    n_blocks, budget = sees.shape[1], _MOST_EDGES
    edges = []
    for some in _edges(n_blocks, joined):
        budget -= len(some[0])
        if budget < 0:
            return _by_rows(sees, by_row)
        edges.append(some)
    return _by_heuristics(n_blocks, edges)


def _edges(n_blocks: int, joined: Callable[[slice], csr_array]) -> Iterator[_Edges]:
    """Give the edges, each once, some rows of the adjacency at a time."""
    for start in range(0, n_blocks, _ROWS_AT_A_TIME):
        edges = joined(slice(start, min(start + _ROWS_AT_A_TIME, n_blocks))).tocoo()
        row, column = edges.row + start, edges.col
        once = row < column
        yield row[once], column[once]


def _by_heuristics(n_blocks: int, edges: Iterable[_Edges]) -> Colours:
    """Colour a graph by saturation and by degree; return the fewer colours."""
    import rustworkx

    # Each edge comes once: rustworkx needn't search for it (half the time on a large graph).
    network: rustworkx.PyGraph[None, None] = rustworkx.PyGraph(multigraph=True)
    network.add_nodes_from([None] * n_blocks)
    for first, second in edges:
        network.extend_from_edge_list(list(zip(first.tolist(), second.tolist(), strict=True)))
    best = np.zeros(n_blocks, np.int32)
    fewest = n_blocks + 1
    for strategy in (rustworkx.ColoringStrategy.Saturation, rustworkx.ColoringStrategy.Degree):
        colours = rustworkx.graph_greedy_color(network, strategy=strategy)
        colouring = np.fromiter((colours[block] for block in range(n_blocks)), np.int32, n_blocks)
        if colouring.max(initial=-1) + 1 < fewest:
            best, fewest = colouring, int(colouring.max(initial=-1)) + 1
    return best


def _by_rows(sees: csc_array, by_row: csr_array) -> Colours:
    """Colour columns by who sees them, then first fit in one order after the other.

    Taken colour by colour, in whatever order of the colours, blocks never need more of them than
    before [J. Culberson, Iterated greedy graph coloring, 1992]: the last colours first, then the
    most frequent, then any order, as long as it helps. A row of k blocks needs k of them.
    """
    # first fit over the columns of a sparse matrix, for groups of columns of a Jacobian; it has
    # no public name
    from scipy.optimize._numdiff import group_columns
    from scipy.sparse import csc_array

    from rfpipe.colouring_kernels import by_saturation

    # which blocks are seen is all that counts: their values take a byte each
    sees = csc_array((np.ones(sees.nnz, np.int8), sees.indices, sees.indptr), shape=sees.shape)
    largest = np.diff(by_row.indptr).max()
    colours = by_saturation(by_row.indptr, by_row.indices, sees.indptr, sees.indices)
    fewest, in_vain, random = int(colours.max()) + 1, 0, generator(0)
    for order in cycle(("last", "largest", "any")):
        if fewest <= largest or in_vain == _IN_VAIN:
            break
        if order == "last":
            rank = np.arange(fewest)[::-1]
        elif order == "largest":
            rank = np.argsort(np.argsort(-np.bincount(colours), kind="stable"))
        else:
            rank = random.permutation(fewest)
        colours = group_columns(sees, np.argsort(rank[colours], kind="stable"))
        count = int(colours.max()) + 1
        fewest, in_vain = count, 0 if count < fewest else in_vain + 1
    return np.asarray(colours, np.int32)
