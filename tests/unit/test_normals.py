"""Normals and albedo by photometric stereo."""

from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import run
from tests.unit.test_lights_between import ball, sphere_of_lights, transport_of

from rfpipe.errors import InputError
from rfpipe.pictures.images import read_image

RANDOM = np.random.default_rng(8)


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=-1), -1, 1)))


@pytest.mark.parametrize(("gloss", "max_degrees"), [(0.0, 0.2), (1.0, 1.5)])
def test_normals_of_a_ball_in_shadow_and_highlight(gloss: float, max_degrees: float) -> None:
    lights = sphere_of_lights(20, 0.2)
    pictures, normals = ball(lights, gloss=gloss)
    pictures[RANDOM.random(pictures.shape) < 0.08] = 0  # cast shadows
    result = transport_of(pictures, lights).normals()
    assert result.mask.mean() > 0.95
    assert np.median(degrees(result.normals, normals)[result.mask]) < max_degrees
    assert np.median(result.albedo[result.mask]) == pytest.approx(0.6, rel=0.05)


def test_the_uncertainty_equals_the_error_of_noise() -> None:
    lights = sphere_of_lights(20, 0.3)
    pictures, normals = ball(lights, 48, gloss=0)
    noisy = pictures + 0.03 * RANDOM.standard_normal(pictures.shape).astype(np.float32)
    result = transport_of(noisy, lights).normals()
    bright = (normals[:, 2] > 0.5)[None]
    error = np.sqrt(np.mean(degrees(result.normals, normals)[bright] ** 2))
    assert 0.5 < np.sqrt(np.mean(result.uncertainty[bright] ** 2)) / error < 2


@pytest.mark.parametrize(
    ("lights", "message"),
    [
        (None, "no directions of its lights"),
        (np.eye(3)[:2], "at least three"),
        (np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0]]), "at least three"),
    ],
)
def test_lights_that_show_no_normals_are_refused(lights: np.ndarray | None, message: str) -> None:
    pictures = RANDOM.random((3 if lights is None else len(lights), 9), np.float32)
    with pytest.raises(InputError, match=message):
        transport_of(pictures, lights).normals()


def test_normals_as_picture_and_exr(tmp_path: Path) -> None:
    import OpenImageIO as oiio

    lights = sphere_of_lights(12, 0.2)
    transport = transport_of(ball(lights)[0], lights)
    transport.save(tmp_path / "ball.zarr")
    result = transport.normals()
    for name in ("n.png", "n.exr"):
        assert "normals of" in run(
            "export", tmp_path / "ball.zarr", "--normals", "-o", tmp_path / name
        )
    codes = read_image(tmp_path / "n.png")
    np.testing.assert_allclose(2 * codes - 1, result.normals, atol=1 / 200)
    parts = {}
    for index in range(3):
        part = oiio.ImageBuf(str(tmp_path / "n.exr"), index, 0)
        parts[part.spec().getattribute("oiio:subimagename")] = part.get_pixels(oiio.FLOAT)
    np.testing.assert_array_equal(parts["normals"], result.normals)
    np.testing.assert_array_equal(parts["albedo"][..., :1], result.albedo)
    np.testing.assert_array_equal(parts["uncertainty"][..., 0], result.uncertainty)
    with pytest.raises(InputError, match=r"expected \.exr .*\.png"):
        run("export", tmp_path / "ball.zarr", "--normals", "-o", tmp_path / "n.jpg")
