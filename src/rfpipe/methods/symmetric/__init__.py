"""Symmetric photography: acquisition of a hierarchical tensor of rank-1 nodes (thesis ch. 5, C.2).

Camera and projector share one ray domain, so that ``T = T^T`` [eq. 2.10]. The tensor is a
sedectree: a node is a pair of blocks (a, b) of one level, and has up to 16 children, one for each
pair (i, j) of a quarter i of a and a quarter j of b (section 4.2). ``T_ab`` is the node's part of
``T``. The picture of a while b is lit is the sum of the columns of ``T_ab``, the picture of b while
a is lit is the sum of its rows, and the two give the rank-1 estimate of the node (Fig. 5.1)::

    x_ab = T_ab 1,    x_ba = T_ab^T 1,    m = sum(x_ab) = sum(x_ba)
    T_ab ~ x_ab x_ba^T / m

=========  ====================  =====================  =========================================
symbol     name in the code      shape                  meaning
=========  ====================  =====================  =========================================
``a, b``   ``block_a, block_b``  (n,) int32             the blocks of each node, ``a <= b``
``i, j``                                                children of block a and of block b
``x_ab``   ``pieces``            rays of block a        *piece* (a, b): light that a receives while
                                                        b is lit, radiance
``m``      ``energy``            (C, n) float64         light that a and b exchange
``w_j``    ``shares_b``          children of block b    ``sum(x_ba[j]) / m``: energy share of
                                                        child j of block b
``w_i``    ``shares_a``          children of block a    ``sum(x_ab[i]) / m``, likewise
``u, v``   `LeafSet`             rays of block a, b     factors of a leaf: ``u = x_ab / sqrt(m)``,
                                                        ``v = x_ba / sqrt(m)``
``G``      ``graph``             blocks x blocks        True where the light between two blocks is
                                                        unknown
``n``                                                   number of nodes or of pairs of blocks
``C, N``                                                number of colour channels, of rays
=========  ====================  =====================  =========================================

A level l passes through these modules:

- `scheduling`: colour ``G^2``, so that the blocks of one colour form a pattern (Lemmas 1 and 2).
- `pieces`: subtract the known leaves' light from the images, which leaves residual images, and cut
  them into pieces.
- `rank_test`: compare the pieces of each node's children with their prediction by the node.
- `classification`: divide the children of nodes that don't become leaves into empty nodes, leaves
  and unknown nodes.
- `method`: the method that connects these steps, and its state.

The compiled loops of three steps are in `piece_kernels`, `rank_test_kernels` and
`classification_kernels`.

The records between these steps; those in brackets are the arguments of kernels::

    SymmetricState.frontier              unknown nodes of level l - 1
     = EstimatedNodes                    [NodeArrays]
         | child_pairs
         v
       pairs of blocks of level l        [Pairs]
         | residual_pieces(images)
         v
       Pieces of these pairs             [Subdivision = NodeArrays + Pieces]
         | rank_test_results
         v
       a RankTestResult per node --------> PASSED_CLEARLY: LeafSet of level l - 1
         | PASSED, FAILED
         v
       NodeCandidates                    [MeasuredPieces, Profiles]
         | classify
         v
       Classification -------------------> LeafSet of level l
         | unknown
         v
       SymmetricState.frontier           unknown nodes of level l

Images are planar and in tree order (`rfpipe.blocks.BlockTree`), in which each block is one run.
"""
