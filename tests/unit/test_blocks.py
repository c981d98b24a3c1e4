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


@pytest.mark.parametrize(("views", "count"), [((), 1), ((2,), 2), ((1,), 1), ((2, 3), 6)])
def test_views_with_any_number_of_axes(views: tuple[int, ...], count: int) -> None:
    domain = RayDomain((*views, 4, 5))
    assert domain.is_stack is bool(views)
    assert domain.size == domain.rays_per_image * count == count * 20
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
