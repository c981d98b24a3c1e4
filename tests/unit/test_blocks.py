"""Ray domains and block trees."""

import numpy as np
import pytest

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError


@pytest.mark.parametrize("shape", [(), (4,), (0, 3), (3, -1), (2, 2, 2, 2), (2, 0, 3)])
def test_a_domain_is_an_image_or_a_stack_of_views(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"a ray domain is \(H, W\) or \(V, H, W\)"):
        RayDomain(shape)


def test_domain_size() -> None:
    assert RayDomain((3, 5)).size == 15
    assert RayDomain((2, 3, 5)).size == 30
    assert not RayDomain((3, 5)).is_stack
    assert RayDomain((2, 3, 5)).is_stack


def test_quadtree_of_eight_by_eight() -> None:
    tree = BlockTree(RayDomain((8, 8)))
    assert [tree.n_blocks(level) for level in range(tree.n_levels)] == [1, 4, 16, 64]
    np.testing.assert_array_equal(
        tree.labels(1), np.kron(np.array([[0, 1], [2, 3]]), np.ones((4, 4), np.int32))
    )
    np.testing.assert_array_equal(tree.child_starts[1], [0, 4, 8, 12, 16])


def test_an_odd_length_splits_into_a_longer_and_a_shorter_half() -> None:
    tree = BlockTree(RayDomain((1, 5)))
    labels = [tree.labels(level)[0].tolist() for level in range(tree.n_levels)]
    assert labels == [[0, 0, 0, 0, 0], [0, 0, 0, 1, 1], [0, 0, 1, 2, 3], [0, 1, 2, 3, 4]]


def test_a_stack_splits_into_its_views_first() -> None:
    tree = BlockTree(RayDomain((3, 2, 2)))
    assert [tree.n_blocks(level) for level in range(tree.n_levels)] == [1, 3, 12]
    np.testing.assert_array_equal(tree.labels(1), np.arange(3)[:, None, None] + np.zeros((1, 2, 2)))


def test_a_single_ray_is_a_tree_of_one_level() -> None:
    tree = BlockTree(RayDomain((1, 1)))
    assert tree.n_levels == 1
    assert tree.n_blocks(0) == 1
    assert tree.child_starts == []


def test_tree_order_there_and_back() -> None:
    tree = BlockTree(RayDomain((3, 4)))
    rays = np.arange(12)
    np.testing.assert_array_equal(rays[tree.order][tree.inverse], rays)
