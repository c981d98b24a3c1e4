"""The light's way on the bench, against what geometry says."""

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.rigs.layout import centred_corners, tilted_corners
from rfpipe.transport.operators import as_pattern_operator
from rfpipe_devices.bench import OpticalPath

SHAPE, PROJECTOR, CAMERA = (6, 8), (40, 50), (33, 44)
RAYS = 48


def path(matrix=None, **settings) -> OpticalPath:  # type: ignore[no-untyped-def]
    scene = as_pattern_operator(np.eye(RAYS) if matrix is None else matrix, RAYS, RAYS)
    corners = centred_corners(SHAPE, PROJECTOR), tilted_corners(SHAPE, CAMERA)
    return OpticalPath(scene, SHAPE, PROJECTOR, CAMERA, *corners, **settings)


def middles(shape: tuple[int, int]) -> np.ndarray:
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    return np.stack([x, y], axis=-1)


def test_the_middle_of_the_picture_sees_the_rays_as_they_are() -> None:
    random = np.random.default_rng(0)
    matrix = random.random((RAYS, RAYS))
    pattern = random.random(SHAPE).astype(np.float32)
    optics = path(matrix)
    image = optics.radiance(optics.layout.picture(pattern))[..., 0]
    rays = (matrix @ pattern.ravel()).reshape(SHAPE)
    # pixels whose corners all lie in one ray
    corners = middles(CAMERA)[..., None, :] + [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    points = optics.projector_points(corners)
    inside = np.isfinite(points).all(axis=(-1, -2))
    u, v = np.floor(np.nan_to_num(points)).astype(int).transpose(3, 0, 1, 2)
    seen = optics.layout.ray_of_pixel[v, u]
    one_ray = inside & (seen == seen[..., :1]).all(axis=-1) & (seen[..., 0] >= 0)
    assert one_ray.sum() > 300
    assert image[one_ray] == pytest.approx(rays.ravel()[seen[..., 0][one_ray]], rel=1e-5)


def test_light_is_neither_lost_nor_made() -> None:
    optics = path()
    image = optics.radiance(optics.layout.picture(np.ones(SHAPE)))
    corners = np.array(tilted_corners(SHAPE, CAMERA)[0])
    x, y = corners.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    assert image.sum() == pytest.approx(area, rel=2e-3)
    assert image.max() == pytest.approx(1)
    assert image.min() == 0


@pytest.mark.parametrize("pixel", [(12, 20), (9, 40)])
def test_a_projector_pixel_appears_where_the_points_say(pixel: tuple[int, int]) -> None:
    optics = path(direct=np.ones((RAYS, 1)))
    light = np.zeros(PROJECTOR, np.float32)
    light[pixel] = 1
    whole = np.zeros(PROJECTOR, np.float32)
    image = (optics.radiance(light) - optics.radiance(whole))[..., 0]
    image[image < 0.5 * image.max()] = 0  # the mean of its ray, without the pixel's own
    centroid = (image[..., None] * middles(CAMERA)).sum(axis=(0, 1)) / image.sum()
    assert optics.projector_points(centroid) == pytest.approx(np.array(pixel[::-1]) + 0.5, abs=0.75)


def test_what_cannot_be_laid_out_is_explained() -> None:
    scene = as_pattern_operator(np.eye(RAYS), RAYS, RAYS)
    outside = [(45, 0), (95, 0), (95, 40), (45, 40)]
    with pytest.raises(InputError, match="rays have no projector pixel"):
        OpticalPath(scene, SHAPE, PROJECTOR, CAMERA, [outside], tilted_corners(SHAPE, CAMERA))
