"""Interpolation between lights, its coverage, and checks of pictures under single lights."""

from collections.abc import Callable

import numpy as np
import pytest

import rfpipe
from rfpipe.environment import Sky, sky_of
from rfpipe.errors import InputError
from rfpipe.fitting.lights import check_lights
from rfpipe.transport.dense import DenseTransport

RANDOM = np.random.default_rng(3)


def sphere_of_lights(count: int, lowest: float = -1.0) -> np.ndarray:
    """Return directions (count, 3) spread evenly over z from `lowest` to 1."""
    z = 1 - (1 - lowest) * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3 - 5**0.5)
    return np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)


def ball(lights: np.ndarray, side: int = 24, gloss: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """Return pictures (L, pixels) of a ball with a highlight, and its normals (pixels, 3)."""
    y, x = (1 - 2 * (place + 0.5) / side for place in np.indices((side, side)))
    inside = x**2 + y**2 < 0.98
    normals = np.stack([-x, y, np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)[inside]
    halfway = lights + np.array([0, 0, 1.0])
    halfway /= np.maximum(np.linalg.norm(halfway, axis=1, keepdims=True), 1e-9)
    facing = np.maximum(lights @ normals.T, 0)
    highlight = gloss * np.maximum(halfway @ normals.T, 0) ** 30 * (facing > 0)
    return (0.6 * facing + highlight).astype(np.float32), normals


def transport_of(pictures: np.ndarray, lights: np.ndarray | None) -> DenseTransport:
    """Return the transport of pictures (L, pixels) of one channel."""
    shape = (1, pictures.shape[1]), (1, len(pictures))
    transport = DenseTransport(*shape, 1, [], {"matrix": np.ascontiguousarray(pictures.T[None])})
    transport.lights = lights
    return transport


def relative(image: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(image.ravel() - truth.ravel()) / np.linalg.norm(truth))


@pytest.mark.parametrize(("count", "limit"), [(12, 0.25), (24, 0.16), (48, 0.12)])
def test_interpolated_light_is_better_than_the_nearest_light(count: int, limit: float) -> None:
    lights, remaining = sphere_of_lights(count, 0), sphere_of_lights(31, 0.2)
    truth, transport = ball(remaining)[0], transport_of(ball(lights)[0], lights)
    errors = [relative(transport.light_from(d), y) for d, y in zip(remaining, truth, strict=True)]
    nearest = ball(lights)[0][(remaining @ lights.T).argmax(axis=1)]
    by_nearest = [relative(a, b) for a, b in zip(nearest, truth, strict=True)]
    assert np.mean(errors) < min(limit, 0.6 * np.mean(by_nearest))


def test_the_light_of_a_measured_direction_is_its_picture() -> None:
    lights = sphere_of_lights(20)
    pictures = ball(lights)[0] * RANDOM.uniform(0.8, 1.2, (20, 1)).astype(np.float32)
    transport = transport_of(pictures, 3 * lights)
    for light, picture in zip(lights, pictures, strict=True):
        np.testing.assert_allclose(transport.light_from(7 * light).ravel(), picture, atol=2e-6)


def test_a_panorama_is_the_sum_of_its_directions() -> None:
    lights = sphere_of_lights(30)
    transport = transport_of(ball(lights)[0], lights)
    panorama = RANDOM.random((64, 128)) ** 20
    sky = sky_of(panorama)
    summed = sum(
        light * transport.light_from(way)
        for way, light in zip(sky.directions[::16], sky.light[::16, 0], strict=True)
    )
    part = Sky(sky.directions[::16], sky.light[::16])
    image = transport.light_interpolation().relight(transport, part)
    assert relative(image, summed) < 2e-2  # each direction's picture is clipped at 0, a table


@pytest.mark.parametrize("count", [1, 2, 3, 5, 60])
def test_weights_of_a_constant_map_add_up_to_the_sphere(count: int) -> None:
    weights = rfpipe.environment_weights(np.full((32, 64, 3), (1.0, 2, 3)), sphere_of_lights(count))
    if count != 2:  # two lights on one axis don't cover a ring
        np.testing.assert_allclose(weights.sum(axis=0), 4 * np.pi * np.array([1, 2, 3]), rtol=1e-5)


def test_directions_far_from_all_lights_stay_dark() -> None:
    lights = sphere_of_lights(40, 0.0)
    transport = transport_of(ball(lights)[0], lights)
    assert transport.light_from([0, 0, 1]).mean() > 0.1
    assert not transport.light_from([0, 0, -1]).any()
    light_behind = np.zeros((16, 32))
    light_behind[8, 0] = 1
    assert not transport.relight_environment(light_behind).any()
    assert rfpipe.environment_coverage(light_behind, lights) == 0
    share = rfpipe.environment_coverage(np.ones((64, 128)), lights)
    assert 0.7 < share < 0.85  # half of the sphere, and twice the spacing beyond its edge
    assert rfpipe.environment_coverage(np.ones((64, 128)), sphere_of_lights(40)) == 1


@pytest.mark.parametrize("direction", [(0, 0, 0), (np.nan, 0, 1), (1, 0)])
def test_invalid_directions_are_rejected(direction: tuple[float, ...]) -> None:
    lights = sphere_of_lights(9)
    transport = transport_of(ball(lights)[0], lights)
    with pytest.raises(InputError, match="direction"):
        transport.light_from(direction)
    with pytest.raises(InputError, match="no directions of its lights"):
        transport_of(ball(lights)[0], None).light_from((0, 0, 1))


def swapped(pictures: np.ndarray) -> None:
    pictures[[3, 20]] = pictures[[20, 3]]


def dead(pictures: np.ndarray) -> None:
    pictures[5] *= 0.001


def doubled(pictures: np.ndarray) -> None:
    pictures[9] = pictures[8]


@pytest.mark.parametrize(
    ("fault", "messages"),
    [
        (swapped, ("p3.png fits the direction of", "p20.png fits the direction of")),
        (dead, ("p5.png is dark",)),
        (doubled, ("p8.png and p9.png are the same picture",)),
    ],
)
def test_faulty_lights_are_named(fault: Callable[[np.ndarray], None], messages) -> None:
    lights = sphere_of_lights(32, 0.1)
    pictures = ball(lights)[0] * RANDOM.uniform(0.7, 1.4, (32, 1)).astype(np.float32)
    pictures += 0.003 * RANDOM.standard_normal(pictures.shape).astype(np.float32)
    names = [f"p{index}.png" for index in range(32)]
    assert check_lights(pictures[:, None], lights, names).faults == ()
    fault(pictures)
    faults = check_lights(pictures[:, None], lights, names).faults
    assert len(faults) == len(messages)
    for message in messages:
        assert any(message in sentence for sentence in faults)


def test_lights_in_one_direction_are_named() -> None:
    lights = sphere_of_lights(32, 0.1)
    pictures = ball(lights)[0]
    lights[7] = lights[6]
    faults = check_lights(pictures[:, None], lights).faults
    assert any("picture 6 and picture 7 have lights in the same direction" in f for f in faults)


@pytest.mark.parametrize("count", [12, 24, 40])
def test_the_error_between_lights_is_estimated(count: int) -> None:
    every = sphere_of_lights(80, 0.1)
    pictures = ball(every)[0] * np.exp(0.1 * RANDOM.standard_normal((80, 1))).astype(np.float32)
    subset = np.sort(RANDOM.permutation(80)[:count])
    check = check_lights(pictures[subset, None], every[subset])
    transport = transport_of(pictures[subset], every[subset])
    remaining = np.setdiff1d(np.arange(80), subset)
    true = np.mean([relative(transport.light_from(every[i]), pictures[i]) for i in remaining])
    assert 1 / 1.3 < check.error / true < 1.3
    assert np.isfinite(check.errors).all()
