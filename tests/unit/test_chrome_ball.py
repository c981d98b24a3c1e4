"""Directions of lights from pictures of a chrome ball."""

from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import run
from tests.unit.test_lights_between import sphere_of_lights

from rfpipe.errors import InputError
from rfpipe.light_files import read_lights
from rfpipe.lights.chrome_ball import Ball, light_of_ball
from rfpipe.pictures.images import write_code_picture

BALL = Ball(60.3, 81.7, 40.0)
SHAPE = (130, 160)


def chrome(
    lights: np.ndarray,
    power: float = 3.0,
    half_angle: float = 4.0,
    ball: Ball = BALL,
    shape: tuple[int, int] = SHAPE,
) -> np.ndarray:
    """Return a picture, 0 to 1, of a ball that reflects lamps (L, 3) and a dim room."""
    side = 4  # samples along a side of a pixel
    rows, columns = ((np.arange(side * n) + 0.5) / side - 0.5 for n in shape)
    x, y = np.meshgrid((columns - ball.column) / ball.radius, (ball.row - rows) / ball.radius)
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    reflected = np.stack([2 * z * x, 2 * z * y, 2 * z**2 - 1], axis=-1)
    lamps = (reflected @ lights.T > np.cos(np.radians(half_angle))).sum(axis=-1)
    radiance = np.where(x**2 + y**2 < 1, 0.1 + 0.05 * reflected[..., 1] + power * lamps, 0.3)
    return np.minimum(radiance, 1).reshape(shape[0], side, shape[1], side).mean(axis=(1, 3))


def degrees(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=-1), -1, 1)))


@pytest.mark.parametrize(
    ("power", "half_angle", "limit"), [(0.6, 4.0, 0.8), (30.0, 4.0, 0.8), (30.0, 1.5, 1.3)]
)
def test_directions_of_rendered_lamps(power: float, half_angle: float, limit: float) -> None:
    lights = sphere_of_lights(30, -0.2)
    directions = [light_of_ball(chrome(d[None], power, half_angle), BALL)[0] for d in lights]
    errors = degrees(np.array(directions), lights)
    assert np.median(errors) < limit / 3
    assert errors.max() < limit


def test_the_brighter_of_two_highlights_is_taken_and_the_other_is_reported() -> None:
    first, second = sphere_of_lights(9, 0.3)[[2, 6]]
    picture = np.maximum(chrome(first[None]), 0.8 * chrome(second[None]))
    found = light_of_ball(picture, BALL)
    assert degrees(found.direction, first) < 0.6
    assert found.second is not None
    assert degrees(found.second, second) < 0.6


@pytest.mark.parametrize(
    ("picture", "ball", "message"),
    [
        (np.zeros(SHAPE), BALL, "black"),
        (chrome(np.array([[0.0, 0.0, 1.0]]), half_angle=60), BALL, "too much for a highlight"),
        (np.ones(SHAPE), BALL._replace(radius=90.0), "not within the picture"),
    ],
)
def test_what_is_no_highlight_is_refused(picture: np.ndarray, ball: Ball, message: str) -> None:
    with pytest.raises(InputError, match=message):
        light_of_ball(picture, ball)


def test_the_command_writes_a_file_that_fit_reads(tmp_path: Path) -> None:
    lights = sphere_of_lights(4, 0.2)
    for index, light in enumerate(lights):
        write_code_picture(tmp_path / f"c {index + 9}.png", chrome(light[None]))
    row, column = np.indices(SHAPE)
    mask = np.hypot(row - BALL.row, column - BALL.column) < BALL.radius
    by_hand = ("--ball", ",".join(map(str, BALL)))
    arguments = ("lights", tmp_path, "-o", tmp_path / "c.lp")
    with pytest.raises(InputError, match="give --ball ROW,COLUMN,RADIUS"):
        run(*arguments)
    with pytest.raises(InputError, match="expected three numbers"):
        run(*arguments, "--ball", "3,4")
    assert "c.lp: 4 lights, from the ball at row 60.3" in run(*arguments, *by_hand)
    names = [f"c {index + 9}.png" for index in range(4)]
    np.testing.assert_allclose(read_lights(tmp_path / "c.lp", names), lights, atol=0.01)
    write_code_picture(tmp_path / "c.mask.png", mask)
    (tmp_path / "c.lp").unlink()
    assert "4 lights" in run(*arguments)
    np.testing.assert_allclose(read_lights(tmp_path / "c.lp", names), lights, atol=0.03)
