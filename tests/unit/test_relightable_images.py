"""Relightable images for museum viewers, decoded by the viewers' formulas."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks.photographs.relightable import decode_folder, decode_ptm
from tests.rigs.known_matrix import run
from tests.unit.test_lights_between import sphere_of_lights

from rfpipe.errors import InputError
from rfpipe.export import relightable_images, write_relightable_image
from rfpipe.export.movies import white_of
from rfpipe.pictures.images import read_image, srgb
from rfpipe.transport.dense import DenseTransport

LIGHTS = sphere_of_lights(24, 0.1)
OBLIQUE = np.array([[0.36, 0.48, 0.8], [-0.6, 0.0, 0.8], [0.1, -0.3, 0.9]])
OBLIQUE /= np.linalg.norm(OBLIQUE, axis=1, keepdims=True)


def relief(
    lights: np.ndarray, channels: int = 3, shape: tuple[int, int] = (40, 56)
) -> DenseTransport:
    """Return a transport of a matt, coloured relief under lights."""
    y, x = np.indices(shape) / 12
    slopes = 0.5 * np.cos(x), 0.6 * np.cos(y + 1), np.ones(shape)
    normals = np.stack(slopes, axis=-1).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tint = np.linspace(0.5, 1, channels)[:, None]
    albedo = tint * (0.1 + 0.6 * x / x.max() + 0.3 * y / y.max()).ravel()
    matrix = albedo[..., None] * np.maximum(normals @ lights.T, 0)
    transport = DenseTransport(
        shape, (1, len(lights)), channels, [], {"matrix": matrix.astype(np.float32)}
    )
    transport.lights = lights
    return transport


def relative(shown: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(shown - truth) / np.linalg.norm(truth))


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with relief.zarr, its relightable image web and web.ptm."""
    folder = tmp_path_factory.mktemp("relief")
    relief(LIGHTS).save(folder / "relief.zarr")
    for name in ("web", "web.ptm"):
        text = run("export", folder / "relief.zarr", "--relight", "-o", folder / name)
        assert re.search(r"image of 40 x 56 pixels, \d+\.\d+% off the pictures of the lights", text)
    return folder


@pytest.mark.parametrize(
    ("name", "decode", "limit"), [("web", decode_folder, 0.03), ("web.ptm", decode_ptm, 0.15)]
)
def test_viewers_show_the_light_of_any_direction(
    exported: Path, name: str, decode: Callable[[Path, np.ndarray], np.ndarray], limit: float
) -> None:
    transport = relief(LIGHTS)
    white = white_of(np.moveaxis(transport.toarray(), -1, 0))
    for direction in OBLIQUE:
        truth = srgb(transport.light_from(direction), white)
        shown = decode(exported / name, direction)
        error = relative(shown, truth)
        assert error < limit
        assert relative(shown[:, ::-1], truth) > 1.2 * error
        assert relative(shown[::-1], truth) > 1.2 * error


def test_a_folder_follows_the_format_of_relight(exported: Path) -> None:
    info = json.loads((exported / "web" / "info.json").read_text())
    assert info | {"lights": 0, "basis": 0, "materials": 0} == {
        "width": 56, "height": 40, "format": "jpg", "type": "bilinear", "resolution": 16,
        "colorspace": "mrgb", "nplanes": 27, "quality": 95,
        "lights": 0, "basis": 0, "materials": 0,
    }  # fmt: skip
    np.testing.assert_allclose(np.reshape(info["lights"], (-1, 3)), LIGHTS, atol=1e-5)
    (material,) = info["materials"]
    assert {name: len(values) for name, values in material.items()} == {
        "range": 27, "scale": 27, "bias": 27,
    }  # fmt: skip
    basis = np.array(info["basis"])
    assert basis.shape == (28 * 16**2 * 3,)
    assert (basis == basis.astype(np.uint8)).all()
    planes = {f"plane_{index}.jpg" for index in range(9)}
    assert {file.name for file in (exported / "web").iterdir()} == {
        "info.json", "index.html", *planes,
    }  # fmt: skip
    assert 'layout: "image"' in (exported / "web" / "index.html").read_text()


def test_large_pictures_have_tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(relightable_images, "LARGEST_PICTURE", 300)
    monkeypatch.setattr(relightable_images, "PLANES", 3)
    write_relightable_image(relief(LIGHTS[:3], 1, (70, 601)), tmp_path / "web")
    whole = read_image(tmp_path / "web" / "plane_0.jpg")
    tiles = tmp_path / "web" / "plane_0_files"
    assert sorted(str(file.relative_to(tiles)) for file in tiles.rglob("*.jpg")) == [
        "0/0_0.jpg", "1/0_0.jpg", "1/1_0.jpg", "2/0_0.jpg", "2/1_0.jpg", "2/2_0.jpg",
    ]  # fmt: skip
    assert 'Width="601" Height="70"' in (tmp_path / "web" / "plane_0.dzi").read_text()
    np.testing.assert_allclose(read_image(tiles / "2" / "1_0.jpg"), whole[:, 255:513], atol=0.1)
    assert read_image(tiles / "0" / "0_0.jpg").shape == (17, 150, 3)
    assert 'layout: "deepzoom"' in (tmp_path / "web" / "index.html").read_text()


@pytest.mark.parametrize(
    ("lights", "name", "message"),
    [
        (None, "web", "no directions of its lights"),
        (LIGHTS * [1, 1, -1], "web", "z points to the camera"),
        (LIGHTS, ".", "exists already"),
        (LIGHTS, "web.rti", r"expected \.ptm"),
    ],
)
def test_what_is_no_dome_is_refused(
    tmp_path: Path, lights: np.ndarray | None, name: str, message: str
) -> None:
    transport = relief(LIGHTS)
    transport.lights = lights
    with pytest.raises(InputError, match=message):
        write_relightable_image(transport, tmp_path / name)


def test_pictures_beyond_the_memory_are_refused_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(relightable_images, "MEMORY_BUDGET", 4 * 3 * 40 * 56 * 24 - 1)
    with pytest.raises(InputError, match=r"3 x 2,240 x 24 entries .* larger --camera-bin"):
        write_relightable_image(relief(LIGHTS), tmp_path / "web")


@pytest.mark.parametrize(
    ("option", "message"),
    [("--normals", "--normals and --relight exclude each other"), ("--dual", "needs all pixels")],
)
def test_options_that_exclude_each_other(exported: Path, option: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        run("export", exported / "relief.zarr", "--relight", option, "-o", exported / "other")
