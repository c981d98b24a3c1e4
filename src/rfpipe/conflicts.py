"""Conflict graphs and their colouring (thesis §3.1, §5.1, Lemmas 1 and 2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Edges go to the colouring library as Python numbers, 100 bytes each: not all of them at a time.
_ROWS_AT_A_TIME = 1024


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
    csr_array of int32, shape (n_blocks, n_blocks)
        1 where two different blocks conflict.
    """
    from scipy.sparse import coo_array

    off_diagonal = first != second
    i, j = first[off_diagonal], second[off_diagonal]
    ones = np.ones(2 * len(i), np.int32)
    graph: csr_array = coo_array(
        (ones, (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n_blocks, n_blocks)
    ).tocsr()
    graph.data[:] = 1
    return graph


def square(graph: csr_array, rows: slice = slice(None)) -> csr_array:
    """Return the square of a graph: an edge between blocks at most two edges apart [Har01].

    Two blocks that are not joined in the square of the graph of unknown transport can be lit
    together (Block Scheduling Lemma, thesis §5.1).

    Parameters
    ----------
    graph : csr_array, shape (n, n)
    rows : slice
        Which of its rows to return.

    Returns
    -------
    csr_array of int32, shape (rows, n)
        1 where two different blocks are joined.
    """
    squared: csr_array = (graph[rows] + graph[rows] @ graph).tocsr()
    squared.setdiag(0, k=rows.start or 0)
    squared.eliminate_zeros()
    squared.data[:] = 1
    return squared


def colour(graph: csr_array, apart: Literal[1, 2] = 1) -> NDArray[np.int32]:
    """Colour a graph so that near blocks differ; the fewer colours of two greedy heuristics.

    Parameters
    ----------
    graph : csr_array, shape (n, n)
        Symmetric adjacency without self-loops.
    apart : {1, 2}
        How many edges apart blocks must differ: 2 colours the graph's square, which is never held
        as a whole.

    Returns
    -------
    ndarray of int32, shape (n,)
        Colours 0, 1, ...; deterministic for a given graph.
    """
    import rustworkx

    n_blocks = graph.shape[0]
    # Each edge comes once: rustworkx needn't search for it (half the time on a large graph).
    network: rustworkx.PyGraph[None, None] = rustworkx.PyGraph(multigraph=True)
    network.add_nodes_from([None] * n_blocks)
    for first in range(0, n_blocks, _ROWS_AT_A_TIME):
        rows = slice(first, min(first + _ROWS_AT_A_TIME, n_blocks))
        edges = (graph[rows] if apart == 1 else square(graph, rows)).tocoo()
        row, column = edges.row + first, edges.col
        once = row < column
        network.extend_from_edge_list(
            list(zip(row[once].tolist(), column[once].tolist(), strict=True))
        )
    best = np.zeros(n_blocks, np.int32)
    fewest = n_blocks + 1
    for strategy in (rustworkx.ColoringStrategy.Saturation, rustworkx.ColoringStrategy.Degree):
        colours = rustworkx.graph_greedy_color(network, strategy=strategy)
        found = np.fromiter((colours[block] for block in range(n_blocks)), np.int32, n_blocks)
        if found.max(initial=-1) + 1 < fewest:
            best, fewest = found, int(found.max(initial=-1)) + 1
    return best
