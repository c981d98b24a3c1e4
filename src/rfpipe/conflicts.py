"""Conflict graphs and their colouring (thesis §3.1, §5.1, Lemmas 1 and 2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array


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


def square(graph: csr_array) -> csr_array:
    """Return the square of a graph: an edge between blocks at most two edges apart [Har01].

    Two blocks that are not joined in the square of the graph of unknown transport can be lit
    together (Block Scheduling Lemma, thesis §5.1).
    """
    squared: csr_array = (graph + graph @ graph).tocsr()
    squared.setdiag(0)
    squared.eliminate_zeros()
    squared.data[:] = 1
    return squared


def colour(graph: csr_array) -> NDArray[np.int32]:
    """Colour a graph so that joined blocks differ; the fewer colours of two greedy heuristics.

    Parameters
    ----------
    graph : csr_array, shape (n, n)
        Symmetric adjacency without self-loops.

    Returns
    -------
    ndarray of int32, shape (n,)
        Colours 0, 1, ...; deterministic for a given graph.
    """
    import rustworkx
    from scipy.sparse import triu

    n_blocks = graph.shape[0]
    edges = triu(graph, k=1).tocoo()
    # Each edge comes once: rustworkx needn't search for it (half the time on a large graph).
    network: rustworkx.PyGraph[None, None] = rustworkx.PyGraph(multigraph=True)
    network.add_nodes_from([None] * n_blocks)
    network.extend_from_edge_list(list(zip(edges.row.tolist(), edges.col.tolist(), strict=True)))
    best = np.zeros(n_blocks, np.int32)
    fewest = n_blocks + 1
    for strategy in (rustworkx.ColoringStrategy.Saturation, rustworkx.ColoringStrategy.Degree):
        colours = rustworkx.graph_greedy_color(network, strategy=strategy)
        found = np.fromiter((colours[block] for block in range(n_blocks)), np.int32, n_blocks)
        if found.max(initial=-1) + 1 < fewest:
            best, fewest = found, int(found.max(initial=-1)) + 1
    return best
