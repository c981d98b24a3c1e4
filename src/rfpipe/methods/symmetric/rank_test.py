"""Rank test: which nodes of the level above are of rank 1 (thesis §5.1, C.2 ProcessResults)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double
from rfpipe.blocks import BlockTree
from rfpipe.methods.symmetric.nodes import EstimatedNodes, compared_pixels
from rfpipe.methods.symmetric.pieces import Subdivision

# The mean of n squared normal deviates is within 1 +- 3 sqrt(2 / n), at three standard deviations.
_DEVIATIONS = 3.0
# Share of the allowed mean square up to which a node is as good a leaf as its children are: a
# quarter of the allowed root mean square.
_SMALL_SHARE = 1.0 / 16


class RankTestResult(IntEnum):
    """Result of the rank test of a node.

    The error of a rank-1 leaf falls with the sides of both its blocks, so that the children's error
    is about a fourth of the node's. A node that passes is therefore replaced by its children, which
    the images have measured already, unless its error is small.
    """

    FAILED = 0
    """The children are classified as empty nodes, leaves or unknown nodes."""
    PASSED = 1
    """The children are leaves, unless they are empty."""
    PASSED_CLEARLY = 2
    """The node is a leaf."""


@dataclass(frozen=True)
class Thresholds:
    """Thresholds of the rank test and of light.

    Attributes
    ----------
    allowed_square : float
        Mean squared difference that the user's tolerance allows in the image of one child, squared
        radiance.
    significance : float
        Standard deviations above which a single measurement of light is significant.
    tests : int
        Number of measurements at this level.
    """

    allowed_square: float
    significance: float
    tests: int

    @property
    def squared_level_significance(self) -> float:
        """Squared standard deviations above which light is worth more patterns.

        The tail of n normal deviates beyond t is about ``n exp(-t^2 / 2)``. With this t, noise
        passes for light anywhere in the level with the probability of a single measurement at
        `significance`.
        """
        return self.significance**2 + 2.0 * math.log(max(self.tests, 1))

    def allowed(self, noise: Double, samples: Double, share: float = 1.0) -> Double:
        """Largest mean squared difference that passes the rank test.

        It is the noise plus the larger of a share of `allowed_square` and of the fluctuation of the
        noise's mean square.

        Parameters
        ----------
        noise : ndarray of float64
            Mean squared difference that noise alone makes, squared radiance.
        samples : ndarray of float64
            Number of pixels of the mean.
        share : float
            Share of `allowed_square`.
        """
        fluctuation = noise * _DEVIATIONS * np.sqrt(2.0 / samples)
        allowed: Double = noise + np.maximum(self.allowed_square * share, fluctuation)
        return allowed


def rank_test_results(
    tree: BlockTree, level: int, nodes: EstimatedNodes, subdivision: Subdivision, limits: Thresholds
) -> NDArray[np.int8]:
    """Test which nodes of `level` predict the pieces of their children within the limits.

    A node whose energy is nearly all in one child, on either side, fails: the images of its
    children repeat its own, whatever its rank. So do nodes whose children are whole views: where
    all views show the same scene points, their images are alike.

    Returns
    -------
    ndarray of int8, shape (n,)
        An `RankTestResult` for each node.
    """
    from rfpipe.methods.symmetric import rank_test_kernels

    if tree.splits_views(level):
        return np.full(len(nodes), RankTestResult.FAILED, np.int8)
    ssd, noise, squares = rank_test_kernels.compare_children(*subdivision)
    samples = compared_pixels(tree, level, nodes)
    outcome = np.full(len(nodes), RankTestResult.FAILED, np.int8)
    for passed, share in (
        (RankTestResult.PASSED, 1.0),
        (RankTestResult.PASSED_CLEARLY, _SMALL_SHARE),
    ):
        allowed = limits.allowed(noise / samples, samples, share)
        outcome[(ssd / samples <= allowed).all(axis=0)] = passed
    outcome[~_has_evidence(tree, level, nodes, squares)] = RankTestResult.FAILED
    return outcome


def _has_evidence(
    tree: BlockTree, level: int, nodes: EstimatedNodes, squares: Double
) -> NDArray[np.bool_]:
    """Test whether the energy of nodes is distributed over several children, bool (n,).

    In every channel, the squared energy shares of the children on at least one side must add up to
    at most ``3 / (children + 2)``. Of four children, two with half of the energy each are at this
    limit, and one with 68 % beside three of 11 %; of two children, 85 % and 15 % are. `squares` is
    a result of `rank_test_kernels.compare_children`.
    """
    children = np.diff(tree.child_starts[level])
    limit = 3.0 / (children[np.stack([nodes.block_b, nodes.block_a])] + 2.0)
    is_distributed = (squares <= limit).any(axis=1) | (nodes.energy == 0)
    evidence: NDArray[np.bool_] = is_distributed.all(axis=0)
    return evidence
