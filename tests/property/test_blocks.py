"""Block trees over ray domains of any number of axes."""

from collections.abc import Iterator
from itertools import product
from math import prod

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rfpipe.blocks import BlockTree, RayDomain

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
trees = st.builds(BlockTree, st.builds(RayDomain, shapes))


def halves(extent: range) -> list[range]:
    if len(extent) == 1:
        return [extent]
    middle = (len(extent) + 1) // 2
    return [extent[:middle], extent[middle:]]


def subdivided(shape: tuple[int, ...]) -> Iterator[list[Box]]:
    """Return the boxes of each level in order, by the definition in `BlockTree`."""
    boxes: list[Box] = [tuple(map(range, shape))]
    yield boxes
    view_axes = len(shape) - 2  # axes that do not split
    if view_axes:
        views = product(*([extent[i : i + 1] for i in extent] for extent in boxes[0][:-2]))
        boxes = [(*view, *boxes[0][-2:]) for view in views]
        yield boxes
    while any(prod(map(len, box)) > 1 for box in boxes):
        boxes = [
            (*box[:view_axes], *child)
            for box in boxes
            for child in product(*map(halves, box[view_axes:]))
        ]
        yield boxes


@given(trees)
def test_levels_halve_the_blocks_repeatedly(tree: BlockTree) -> None:
    shape = tree.domain.shape
    levels = list(subdivided(shape))
    assert tree.n_levels == len(levels)
    for level, boxes in enumerate(levels):
        expected = np.empty(shape, np.int32)
        for number, box in enumerate(boxes):
            expected[tuple(slice(extent.start, extent.stop) for extent in box)] = number
        np.testing.assert_array_equal(tree.labels(level), expected)
        sizes = [prod(map(len, box)) for box in boxes]
        np.testing.assert_array_equal(tree.starts[level], np.cumsum([0, *sizes]))
        np.testing.assert_array_equal(
            tree.block_of_position(level), np.repeat(np.arange(len(boxes)), sizes)
        )
    order = [np.ravel_multi_index([extent.start for extent in box], shape) for box in levels[-1]]
    np.testing.assert_array_equal(tree.order, order)
    np.testing.assert_array_equal(tree.order[tree.inverse], np.arange(tree.domain.size))


@given(trees)
def test_children_partition_their_block(tree: BlockTree) -> None:
    for level in range(tree.n_levels - 1):
        children = tree.child_starts[level]
        np.testing.assert_array_equal(tree.starts[level + 1][children], tree.starts[level])
        parents = tree.ancestors(level + 1, level)
        np.testing.assert_array_equal(
            parents, np.repeat(np.arange(len(children) - 1), np.diff(children))
        )
        np.testing.assert_array_equal(parents[tree.labels(level + 1)], tree.labels(level))


@given(shapes)
def test_rays_have_a_view_and_stack_as_images(shape: tuple[int, ...]) -> None:
    domain = RayDomain(shape)
    rays = np.arange(domain.size)
    of_view = domain.view_of(rays).reshape(domain.stack_shape)
    assert (of_view == np.arange(domain.views)[:, None, None]).all()
    assert domain.size == domain.views * domain.rays_per_image == prod(domain.picture_shape)
    assert domain.is_stack == (len(shape) > 2)
