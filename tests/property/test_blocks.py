"""Block trees over ray domains of any number of axes, split either way."""

from collections.abc import Iterator
from itertools import product
from math import prod
from typing import get_args

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain, Split

Box = tuple[range, ...]

images = st.tuples(st.integers(1, 40), st.integers(1, 40))
stacks = st.tuples(st.integers(1, 6), st.integers(1, 12), st.integers(1, 12))
grids = st.tuples(st.integers(1, 4), st.integers(1, 4), st.integers(1, 7), st.integers(1, 7))
lines = st.one_of(
    st.tuples(st.just(1), st.integers(1, 130)), st.tuples(st.integers(1, 130), st.just(1))
)
primes = st.tuples(*2 * [st.sampled_from([2, 3, 5, 7, 13, 29, 31])])
prime_grids = st.tuples(*4 * [st.sampled_from([2, 3, 5, 7])])
five_axes = st.tuples(*5 * [st.integers(1, 3)])
shapes = st.one_of(images, stacks, grids, lines, primes, prime_grids, five_axes)
trees = st.builds(BlockTree, st.builds(RayDomain, shapes), st.sampled_from(get_args(Split)))


def halves(extent: range) -> list[range]:
    if len(extent) == 1:
        return [extent]
    middle = (len(extent) + 1) // 2
    return [extent[:middle], extent[middle:]]


def subdivided(shape: tuple[int, ...], split: Split) -> Iterator[list[Box]]:
    """The boxes of each level, in order, as the words of `BlockTree` have it."""
    boxes: list[Box] = [tuple(map(range, shape))]
    yield boxes
    whole = 0  # axes that do not split
    if split == "views_first" and len(shape) > 2:
        whole = len(shape) - 2
        views = product(*([extent[i : i + 1] for i in extent] for extent in boxes[0][:-2]))
        boxes = [(*view, *boxes[0][-2:]) for view in views]
        yield boxes
    while any(prod(map(len, box)) > 1 for box in boxes):
        boxes = [
            (*box[:whole], *child) for box in boxes for child in product(*map(halves, box[whole:]))
        ]
        yield boxes


@given(trees)
def test_a_tree_is_what_halving_makes(tree: BlockTree) -> None:
    shape = tree.domain.shape
    levels = list(subdivided(shape, tree.split))
    assert tree.n_levels == len(levels)
    for level, boxes in enumerate(levels):
        expected = np.empty(shape, np.int32)
        for number, box in enumerate(boxes):
            expected[tuple(slice(extent.start, extent.stop) for extent in box)] = number
        np.testing.assert_array_equal(tree.labels(level), expected)
    order = [np.ravel_multi_index([extent.start for extent in box], shape) for box in levels[-1]]
    np.testing.assert_array_equal(tree.order, order)


@given(trees)
def test_block_tree_partitions_its_domain(tree: BlockTree) -> None:
    rays = np.arange(tree.domain.size)
    np.testing.assert_array_equal(np.sort(tree.order), rays)
    np.testing.assert_array_equal(tree.order[tree.inverse], rays)
    assert tree.n_blocks(0) == 1
    assert tree.n_blocks(tree.n_levels - 1) == tree.domain.size
    for level in range(tree.n_levels):
        starts = tree.starts[level]
        assert starts[0] == 0
        assert starts[-1] == tree.domain.size
        assert (np.diff(starts) > 0).all()
        # Contiguous in tree order: the labels, read in that order, count up.
        in_order = tree.labels(level).ravel()[tree.order]
        np.testing.assert_array_equal(in_order, tree.block_of_position(level))


@given(trees)
def test_children_make_up_their_block(tree: BlockTree) -> None:
    for level in range(tree.n_levels - 1):
        children = tree.child_starts[level]
        np.testing.assert_array_equal(tree.starts[level + 1][children], tree.starts[level])
        most = 4 if tree.split == "views_first" else 2 ** len(tree.domain.shape)
        if tree.split == "views_first" and tree.domain.is_stack and level == 0:
            most = tree.domain.views
        assert np.diff(children).min() >= 1
        assert np.diff(children).max() <= most
        parents = tree.ancestors(level + 1, level)
        np.testing.assert_array_equal(
            parents, np.repeat(np.arange(len(children) - 1), np.diff(children))
        )
        np.testing.assert_array_equal(parents[tree.labels(level + 1)], tree.labels(level))


@given(trees)
def test_blocks_are_boxes_halved_as_evenly_as_can_be(tree: BlockTree) -> None:
    shape = tree.domain.shape
    one_view_each = tree.split == "views_first" and tree.domain.is_stack
    for level in range(1 if one_view_each else 0, tree.n_levels):
        labels = tree.labels(level).ravel()
        bounds = []
        for axis in np.indices(shape).reshape(len(shape), -1):
            low = np.full(tree.n_blocks(level), max(shape))
            high = np.full(tree.n_blocks(level), -1)
            np.minimum.at(low, labels, axis)
            np.maximum.at(high, labels, axis)
            bounds.append(high - low + 1)
        np.testing.assert_array_equal(np.prod(bounds, axis=0), np.diff(tree.starts[level]))
        for lengths in bounds:
            assert lengths.max() - lengths.min() <= 1
        if one_view_each:
            assert (np.stack(bounds[:-2]) == 1).all()


@given(st.one_of(stacks, grids, five_axes))
def test_how_views_are_arranged_does_not_matter_to_a_tree_that_splits_them_first(
    shape: tuple[int, ...],
) -> None:
    domain = RayDomain(shape)
    arranged, stacked = BlockTree(domain), BlockTree(RayDomain(domain.stack_shape))
    np.testing.assert_array_equal(arranged.order, stacked.order)
    for one, other in zip(arranged.starts, stacked.starts, strict=True):
        np.testing.assert_array_equal(one, other)


@given(images)
def test_an_image_splits_the_same_either_way(shape: tuple[int, ...]) -> None:
    one, other = (BlockTree(RayDomain(shape), split) for split in get_args(Split))
    np.testing.assert_array_equal(one.order, other.order)
    assert one.n_levels == other.n_levels


@given(shapes)
def test_rays_know_their_view_and_stack_up_as_images(shape: tuple[int, ...]) -> None:
    domain = RayDomain(shape)
    rays = np.arange(domain.size)
    of_view = domain.view_of(rays).reshape(domain.stack_shape)
    assert (of_view == np.arange(domain.views)[:, None, None]).all()
    assert domain.size == domain.views * domain.rays_per_image == prod(domain.picture_shape)
    assert (*domain.views_shape, *domain.image_shape) == shape
    assert domain.is_stack == (len(shape) > 2)
