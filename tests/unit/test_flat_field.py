"""Uneven light that pictures of a white card divide out."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import run
from tests.unit.test_lights_between import sphere_of_lights

import rfpipe
from rfpipe.errors import InputError
from rfpipe.fitting import Series, flat_fielded
from rfpipe.light_files import write_directions
from rfpipe.pictures.images import write_code_picture

LIGHTS = sphere_of_lights(12, 0.3)
SHAPE = (30, 40)
POWER = np.exp(0.2 * np.random.default_rng(1).standard_normal(12))


def pictures(near: bool, is_card: bool = False) -> np.ndarray:
    """Return pictures (L, H, W), 0 to 1, of a relief or a card, under near or distant lamps."""
    y, x = (np.indices(SHAPE) - np.array(SHAPE)[:, None, None] / 2) / max(SHAPE)
    slopes = 0.4 * np.sin(9 * x), 0.3 * np.sin(11 * y), np.ones(SHAPE)
    normals = np.stack(slopes, axis=-1) * ([0, 0, 1] if is_card else [1, 1, 1])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    albedo = 0.9 if is_card else 0.5 + 0.3 * np.sin(20 * x + 5 * y)
    towards = 3 * LIGHTS[:, None, None] - near * np.stack([x, -y, 0 * x], axis=-1)
    distance = np.linalg.norm(towards, axis=-1)
    shading = np.maximum((towards * normals).sum(axis=-1) / distance, 0)
    power = POWER[:, None, None] if near else 1
    return 0.5 * power * albedo * shading * (3 / distance) ** 2


def relative(image: np.ndarray, truth: np.ndarray) -> float:
    scale = (image * truth).sum() / (image**2).sum()
    return float(np.linalg.norm(scale * image - truth) / np.linalg.norm(truth))


def test_near_lamps_of_unequal_power(tmp_path: Path) -> None:
    names = [f"{index:02d}.png" for index in range(12)]
    for folder, images in (("coin", pictures(True)), ("card", pictures(True, is_card=True))):
        (tmp_path / folder).mkdir()
        for name, image in zip(names, images, strict=True):
            write_code_picture(tmp_path / folder / name, image)
    write_directions(tmp_path / "coin" / "coin.lp", names, LIGHTS)
    truth = np.moveaxis(pictures(False), 0, -1)
    errors = []
    for options in ((), ("--flat-field", tmp_path / "card")):
        run("fit", tmp_path / "coin", "-o", tmp_path / "coin.zarr", *options)
        matrix = rfpipe.open_transport(tmp_path / "coin.zarr").toarray()
        errors.append(relative(matrix.reshape(truth.shape), truth))
    assert errors[0] > 0.15
    assert errors[1] < 0.05
    (tmp_path / "card" / names[0]).unlink()
    with pytest.raises(InputError, match="11 pictures of 12 patterns"):
        run("fit", tmp_path / "coin", "-o", tmp_path / "coin.zarr", *options)


def series(lights: np.ndarray | None, radiance: np.ndarray) -> Series:
    patterns = np.eye(len(radiance), dtype=np.float32)[:, None]
    light = radiance.reshape(len(radiance), 1, -1).astype(np.float32)
    return Series((1, light.shape[2]), (1, len(light)), patterns, light, 0 * light, lights=lights)


@pytest.mark.parametrize(
    ("lights", "card", "message"),
    [
        (None, np.ones((3, 5)), "file of their directions"),
        (LIGHTS[:3] * [1, 1, -1], np.ones((3, 5)), "behind a card"),
        (LIGHTS[:3], np.ones((3, 4)), "a picture of the white card for each light"),
        (LIGHTS[:3], np.zeros((3, 5)), "dark or saturated"),
    ],
)
def test_what_is_no_flat_field_is_refused(
    lights: np.ndarray | None, card: np.ndarray, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        flat_fielded(series(lights, np.ones((3, 5))), series(None, card))


def test_pixels_of_a_dark_card_are_unknown() -> None:
    card = np.ones((3, 5))
    card[1, 2] = 0
    unknown = replace(series(None, card), variance=np.zeros((3, 1, 5), np.float32))
    flat = flat_fielded(series(LIGHTS[:3], np.ones((3, 5))), unknown)
    assert flat.known.tolist() == [True, True, False, True, True]
    assert not flat.radiance[..., 2].any()
