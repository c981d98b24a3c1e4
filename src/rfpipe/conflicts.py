"""Conflict graphs of blocks and their colouring (thesis §3.1, §5.1, Lemmas 1 and 2).

Blocks that conflict can't be lit together; the blocks of one colour are one pattern. In symmetric
photography the conflicts are the edges of ``G^2``, the square of the graph ``G`` of blocks between
which the light is unknown. In dual photography two blocks conflict where a camera pixel sees both.

Small graphs are built explicitly, as lists of their edges, and coloured by a library. Large ones
are coloured from the sparse matrix of the pixels that see each block, without listing their
conflicts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator

if TYPE_CHECKING:
    from scipy.sparse import csc_array, csr_array

__all__ = ["colour_columns", "colour_square", "conflict_graph", "square"]

Colours = NDArray[np.int32]
_Edges = tuple[NDArray[np.integer], NDArray[np.integer]]

# rustworkx takes edges as Python numbers, 100 bytes for each: they are passed on in batches. It
# stores an edge in 24 bytes and colours a million in a second; larger graphs are not built.
_ROWS_PER_BATCH = 1024
_MOST_EDGES = 2**22
# Consecutive orders that save no colour, after which the iterated greedy colouring stops.
_MOST_FAILURES = 3


def conflict_graph(
    n_blocks: int, first: NDArray[np.integer], second: NDArray[np.integer]
) -> csr_array:
    """Build the symmetric adjacency matrix of the blocks' conflicts.

    Parameters
    ----------
    n_blocks : int
    first, second : ndarray of int, shape (E,)
        The two blocks of each conflict; repeats and conflicts of a block with itself are dropped.

    Returns
    -------
    csr_array of bool, shape (n_blocks, n_blocks)
        True where two different blocks conflict.
    """
    from scipy.sparse import coo_array

    edges = np.ones(len(first), np.bool_)
    upper = coo_array((edges, (first, second)), shape=(n_blocks, n_blocks)).tocsr()
    upper.setdiag(False)
    upper.eliminate_zeros()
    graph: csr_array = (upper + upper.T).tocsr()
    return graph


def square(graph: csr_array, rows: slice = slice(None)) -> csr_array:
    """Return the square of a graph: an edge between blocks at most two edges apart [Har01].

    Two blocks without an edge in the square of the graph of unknown transport can be lit together
    (Block Scheduling Lemma, thesis §5.1).

    Parameters
    ----------
    graph : csr_array of bool, shape (n, n)
    rows : slice
        Rows of the square to return.

    Returns
    -------
    csr_array of bool, shape (rows, n)
        True where two different blocks have an edge.
    """
    squared: csr_array = (graph[rows] + graph[rows] @ graph).tocsr()
    squared.setdiag(False, k=rows.start or 0)
    squared.eliminate_zeros()
    return squared


def colour_square(graph: csr_array) -> Colours:
    """Colour the square of a graph: blocks at most two edges apart get different colours.

    Parameters
    ----------
    graph : csr_array of bool, shape (n, n)
        Symmetric adjacency without self-loops. Its square is never in memory as a whole.

    Returns
    -------
    ndarray of int32, shape (n,)
        Colours 0, 1, ...; deterministic for a given graph.
    """
    from scipy.sparse import eye_array

    # a row has the block itself and its neighbours, any two of which are at most two edges apart
    rows = (graph + eye_array(graph.shape[0], dtype=graph.dtype, format="csr")).tocsr()
    return _colour(rows.T, rows, lambda batch: square(graph, batch))


def colour_columns(response: csr_array) -> Colours:
    """Colour the columns of a matrix so that no row has two of one colour.

    Parameters
    ----------
    response : csr_array, shape (m, n)
        Not zero where the row's pixel sees the column's block.

    Returns
    -------
    ndarray of int32, shape (n,)
        Colours 0, 1, ...; deterministic for a given matrix.
    """
    by_block = response.T.tocsr().astype(np.int32)
    by_pixel = response.tocsr().astype(np.int32)

    def adjacency(rows: slice) -> csr_array:
        common_pixels: csr_array = by_block[rows] @ by_pixel
        common_pixels.sort_indices()
        return common_pixels

    return _colour(response.tocsc(), response.tocsr(), adjacency)


def _colour(
    columns: csc_array, rows: csr_array, adjacency: Callable[[slice], csr_array]
) -> Colours:
    """Colour the columns of a matrix, given by columns and by rows.

    `adjacency` computes rows of the conflict graph, the diagonal of which is ignored.
    """
    n_blocks, remaining = columns.shape[1], _MOST_EDGES
    edges = []
    for batch in _edges(n_blocks, adjacency):
        remaining -= len(batch[0])
        if remaining < 0:
            return _by_iterated_greedy(columns, rows)
        edges.append(batch)
    return _by_library(n_blocks, edges)


def _edges(n_blocks: int, adjacency: Callable[[slice], csr_array]) -> Iterator[_Edges]:
    """Yield the edges of a graph in batches, each edge once."""
    for start in range(0, n_blocks, _ROWS_PER_BATCH):
        edges = adjacency(slice(start, min(start + _ROWS_PER_BATCH, n_blocks))).tocoo()
        row, column = edges.row + start, edges.col
        upper = row < column
        yield row[upper], column[upper]


def _by_library(n_blocks: int, edges: Iterable[_Edges]) -> Colours:
    """Colour a graph greedily by saturation and by degree, and return the fewer colours."""
    import rustworkx

    # edges are unique: a multigraph doesn't search for them, half of the time on a large graph
    graph: rustworkx.PyGraph[None, None] = rustworkx.PyGraph(multigraph=True)
    graph.add_nodes_from([None] * n_blocks)
    for first, second in edges:
        graph.extend_from_edge_list(list(zip(first.tolist(), second.tolist(), strict=True)))
    best = np.zeros(n_blocks, np.int32)
    fewest = n_blocks + 1
    for strategy in (rustworkx.ColoringStrategy.Saturation, rustworkx.ColoringStrategy.Degree):
        colours = rustworkx.graph_greedy_color(graph, strategy=strategy)
        colouring = np.fromiter((colours[block] for block in range(n_blocks)), np.int32, n_blocks)
        if colouring.max(initial=-1) + 1 < fewest:
            best, fewest = colouring, int(colouring.max(initial=-1)) + 1
    return best


def _by_iterated_greedy(columns: csc_array, rows: csr_array) -> Colours:
    """Colour columns by saturation, then by first fit in several orders.

    First fit over whole colours, in any order of the colours, never needs more colours than before
    [J. Culberson, Iterated greedy graph coloring, 1992]. The orders are the last colours first, the
    most frequent first, and a random one, as long as they save colours. The lower bound is the
    number of blocks in the longest row.
    """
    # the library's first fit over the columns of a sparse matrix, for finite differences of a
    # Jacobian, has no public name
    from scipy.optimize._numdiff import group_columns
    from scipy.sparse import csc_array

    from rfpipe.colouring_kernels import colour_by_saturation

    # the values don't count: one byte per value saves memory
    pattern = csc_array(
        (np.ones(columns.nnz, np.int8), columns.indices, columns.indptr), shape=columns.shape
    )
    bound = np.diff(rows.indptr).max()
    colours = colour_by_saturation(rows.indptr, rows.indices, pattern.indptr, pattern.indices)
    fewest, failures, random = int(colours.max()) + 1, 0, generator(0)
    for order in cycle(("last", "largest", "random")):
        if fewest <= bound or failures == _MOST_FAILURES:
            break
        if order == "last":
            rank = np.arange(fewest)[::-1]
        elif order == "largest":
            rank = np.argsort(np.argsort(-np.bincount(colours), kind="stable"))
        else:
            rank = random.permutation(fewest)
        colours = group_columns(pattern, np.argsort(rank[colours], kind="stable"))
        count = int(colours.max()) + 1
        fewest, failures = count, 0 if count < fewest else failures + 1
    return np.asarray(colours, np.int32)
