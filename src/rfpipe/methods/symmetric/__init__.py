"""Symmetric photography: acquisition of a hierarchical tensor of rank-1 nodes (thesis ch. 5, C.2).

Camera and projector share one ray domain, so that ``T = T^T`` [eq. 2.10]. The tensor is a
sedectree: a node is a pair of blocks (a, b) of one level, and has up to 16 children, one for each
pair of a quarter of a and a quarter of b (section 4.2). ``T_ab`` is the node's part of ``T``. The
picture of a while b is lit is the sum of its columns, the picture of b while a is lit is the sum of
its rows, and the two give the rank-1 estimate of the node (Fig. 5.1)::

    c_ab = T_ab 1,    c_ba = T_ab^T 1,    m = sum(c_ab) = sum(c_ba)
    T_ab ~ c_ab c_ba^T / m

=========  ====================  =====================  =========================================
symbol     name in the code      shape                  meaning
=========  ====================  =====================  =========================================
``a, b``   ``block_a, block_b``  (n,) int32             the node's blocks, ``a <= b``
``c_ab``   *piece* (a, b)        rays of block a        light that a receives while b is lit
``m``      ``energy``            (C, n) float64         light that a and b exchange
``w_j``    ``shares``            children of b          ``sum(c_ba[j]) / m``: part of ``m`` in
                                                        child j of block b
``G``      ``graph``             blocks x blocks        True where the light between two blocks is
                                                        unknown
=========  ====================  =====================  =========================================

A level passes through these modules:

- `scheduling`: colour ``G^2``, so that the blocks of one colour form a pattern (Lemmas 1 and 2).
- `pieces`: subtract the known leaves' light from the images, which leaves residual images, and cut
  them into pieces.
- `rank_test`: compare the pieces of each node's children with their prediction by the node.
- `classification`: divide the children of failed nodes into empty nodes, leaves and unknown nodes.
- `method`: the method that connects these steps, and its state.

Images are planar and in tree order (`rfpipe.blocks.BlockTree`), in which each block is one run.
"""
