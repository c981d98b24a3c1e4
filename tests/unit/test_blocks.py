"""Ray domains and block trees."""

import re
from typing import Any

import numpy as np
import pytest

from rfpipe.blocks import BlockTree, RayDomain, ray_shape
from rfpipe.errors import InputError


@pytest.mark.parametrize(
    "shape", [(), (4,), (0, 3), (3, -1), (2, 0, 3), (2, 2, 0, 2), 16, (2.5, 3), "ab"]
)
def test_a_domain_is_an_image_or_views(shape: Any) -> None:
    message = f"the ray domain is {shape!r}; expected height and width, (H, W), or axes of views"
    with pytest.raises(InputError, match=re.escape(message)):
        RayDomain(shape)


def test_an_error_names_the_setting_that_should_be_a_domain() -> None:
    assert ray_shape((np.int64(3), 5), "camera_shape") == (3, 5)
    with pytest.raises(InputError, match="camera_shape is 16; expected"):
        ray_shape(16, "camera_shape")  # type: ignore[arg-type]


def test_an_image_by_itself() -> None:
    domain = RayDomain((3, 5))
    assert domain.size == domain.rays_per_image == 15
    assert not domain.is_stack
    assert (domain.views, domain.views_shape, domain.image_shape) == (1, (), (3, 5))
    assert domain.stack_shape == (1, 3, 5)
    assert domain.picture_shape == (3, 5)


@pytest.mark.parametrize(("views", "count"), [((2,), 2), ((1,), 1), ((2, 3), 6)])
def test_views_with_any_number_of_axes(views: tuple[int, ...], count: int) -> None:
    domain = RayDomain((*views, 4, 5))
    assert domain.is_stack
    assert domain.size == count * 20
    assert (domain.views, domain.views_shape, domain.image_shape) == (count, views, (4, 5))
    assert domain.stack_shape == (count, 4, 5)
    assert domain.picture_shape == (4 * count, 5)
    np.testing.assert_array_equal(
        domain.view_of(np.array([0, 19, count * 20 - 1])), [0, 0, count - 1]
    )
    assert domain.view_of(np.array([-1]))[0] == -1


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


def test_views_in_rows_and_columns_split_first_as_a_stack_does() -> None:
    tree = BlockTree(RayDomain((2, 3, 4, 4)))
    assert [tree.n_blocks(level) for level in range(tree.n_levels)] == [1, 6, 24, 96]
    views = np.arange(6).reshape(2, 3, 1, 1)
    np.testing.assert_array_equal(tree.labels(1), np.broadcast_to(views, (2, 3, 4, 4)))


def test_all_axes_split_together_into_sixteen_children() -> None:
    tree = BlockTree(RayDomain((4, 4, 4, 4)), "all_axes")
    assert [tree.n_blocks(level) for level in range(tree.n_levels)] == [1, 16, 256]
    for children in tree.child_starts:
        assert (np.diff(children) == 16).all()
    halves = np.array([0, 0, 1, 1])
    expected = sum(
        np.reshape(halves << 3 - axis, [-1 if axis == i else 1 for i in range(4)])
        for axis in range(4)
    )
    np.testing.assert_array_equal(tree.labels(1), expected)


def test_of_axes_that_split_together_short_ones_are_done_first() -> None:
    tree = BlockTree(RayDomain((2, 1, 8, 3)), "all_axes")
    assert [tree.n_blocks(level) for level in range(tree.n_levels)] == [1, 8, 24, 48]
    np.testing.assert_array_equal(tree.labels(1)[1, 0, 0], [4, 4, 5])


def test_a_split_that_no_tree_knows() -> None:
    with pytest.raises(
        InputError, match="split is 'octree'; expected one of views_first, all_axes"
    ):
        BlockTree(RayDomain((2, 2)), "octree")  # type: ignore[arg-type]


def test_a_single_ray_is_a_tree_of_one_level() -> None:
    tree = BlockTree(RayDomain((1, 1)))
    assert tree.n_levels == 1
    assert tree.n_blocks(0) == 1
    assert tree.child_starts == []


def test_tree_order_there_and_back() -> None:
    tree = BlockTree(RayDomain((3, 4)))
    rays = np.arange(12)
    np.testing.assert_array_equal(rays[tree.order][tree.inverse], rays)
