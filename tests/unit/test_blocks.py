"""Ray domains and block trees."""

import re
from typing import Any

import numpy as np
import pytest

from rfpipe.blocks import RayDomain, ray_shape
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
