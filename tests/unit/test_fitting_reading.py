"""Pictures of a fit: averaged, saturated, masked, and within memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import yaml
from tests.rigs.known_matrix import run
from tests.rigs.structured_light import shot

from rfpipe import open_transport
from rfpipe.errors import InputError
from rfpipe.fitting import Series, fit_transport, read_series
from rfpipe.fitting.binning import Bins, bin_image, binned_shape, proposed_bins


def write(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True, parents=True)
    assert oiio.ImageBuf(np.ascontiguousarray(pixels)).write(str(path))


def write_gray_code(folder: Path, projector=(16, 20), camera=(40, 48)) -> np.ndarray:
    """Write pictures of a Gray code with white and black; return the counts (K, H, W)."""
    capture = shot(projector, camera, 3)
    pictures = np.vstack([capture.pictures, np.zeros_like(capture.pictures[:1])])
    counts = np.clip(np.rint(200 * (pictures + 0.05)), 0, 255).astype(np.uint8)
    counts = counts.reshape(-1, *camera)
    for index, picture in enumerate(counts):
        write(folder / f"im{index + 1}.png", picture[..., None])
    return counts


@pytest.mark.parametrize("side", [1, 2, 3, 7])
def test_squares_are_averaged_over_known_pixels(side: int) -> None:
    random = np.random.default_rng(side)
    image = random.random((9, 14, 3)).astype(np.float32)
    known = random.random((9, 14)) < 0.6
    binned = bin_image(image, side, known)
    assert binned.shape == (*binned_shape((9, 14), side), 3)
    for row, column in np.ndindex(*binned.shape[:2]):
        square = np.s_[row * side : (row + 1) * side, column * side : (column + 1) * side]
        inside = image[square][known[square]]
        expected = inside.mean(axis=0) if len(inside) else np.zeros(3)
        np.testing.assert_allclose(binned[row, column], expected, rtol=1e-5)


def test_saturated_pixels_are_excluded_from_averages(tmp_path: Path) -> None:
    counts = write_gray_code(tmp_path)
    counts[3, 0, 0] = 255  # saturated in one picture
    counts[:, 2:4, 0:2] = 255  # a complete square
    for index, picture in enumerate(counts):
        write(tmp_path / f"im{index + 1}.png", picture[..., None])
    series = read_series(tmp_path, patterns="gray:20x16", camera_bin=2)
    assert (series.camera_shape, series.projector_shape) == ((20, 24), (16, 20))
    known = series.known.reshape(20, 24)
    assert not known[1, 0]
    assert known.sum() == known.size - 1
    light = counts[:-1].astype(float) - counts[-1]
    three = light[:, [0, 1, 1], [1, 0, 1]].mean(axis=1)
    np.testing.assert_allclose(series.radiance[:, 0, 0], three / 255, atol=1e-6)
    assert not any("pixels are saturated" in note for note in series.notes)


def test_more_than_1_percent_of_saturated_pixels_is_noted(tmp_path: Path) -> None:
    counts = write_gray_code(tmp_path)
    counts[-2, :, :14] = 255
    for index, picture in enumerate(counts):
        write(tmp_path / f"im{index + 1}.png", picture[..., None])
    notes = read_series(tmp_path, patterns="gray:20x16").notes
    (note,) = (note for note in notes if "pixels are saturated" in note)
    assert "29%" in note
    assert "expose shorter" in note
    write(tmp_path / f"im{len(counts) - 1}.png", np.full((40, 48, 1), 255, np.uint8))
    with pytest.raises(InputError, match="every pixel saturates"):
        read_series(tmp_path, patterns="gray:20x16")


def test_a_mask_beside_the_pictures_excludes_pixels(tmp_path: Path) -> None:
    write_gray_code(tmp_path)
    mask = np.zeros((40, 48, 1), np.uint8)
    mask[10:30] = 255
    write(tmp_path / "mask.png", mask)
    known = read_series(tmp_path, patterns="gray:20x16").known.reshape(40, 48)
    assert known[10:30].all()
    assert known.sum() == 20 * 48
    write(tmp_path / "mask.png", mask[:-1])
    with pytest.raises(InputError, match=r"mask\.png: is a mask of"):
        read_series(tmp_path, patterns="gray:20x16")


def test_bins_limit_the_memory_of_a_fit() -> None:
    camera, projector, samples = (1500, 2048), (1080, 1920), 46 * 4
    bins = [proposed_bins(camera, projector, samples, gib * 2**30) for gib in (0.25, 2, 64)]
    assert bins[0].camera > bins[1].camera > 1
    assert bins[0].projector > bins[1].projector > 1
    assert bins[2] == Bins(1, 1) or bins[2].camera < bins[1].camera
    assert proposed_bins((48, 64), (32, 32), 40, 2 * 2**30) == Bins(1, 1)


def test_automatic_bins_are_noted_and_given_bins_are_used(tmp_path: Path) -> None:
    write_gray_code(tmp_path)
    series = read_series(tmp_path, patterns="gray:20x16", memory_gib=0.005)
    (note,) = (n for n in series.notes if "averaged" in n)
    assert "--camera-bin" in note
    assert series.camera_shape < (40, 48)
    wished = read_series(
        tmp_path, patterns="gray:20x16", camera_bin=1, projector_bin=1, memory_gib=0.005
    )
    assert (wished.camera_shape, wished.projector_shape) == ((40, 48), (16, 20))


def test_gray_code_by_name_fits_from_the_command_line(tmp_path: Path) -> None:
    counts = write_gray_code(tmp_path / "set")
    output = tmp_path / "t.zarr"
    settings = {"camera": {"exposures": [1.0], "bits": 8, "black_level_counts": 0}}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(settings))
    for more in ([], ["--settings", tmp_path / "camera.yaml"]):
        text = run(
            "fit", tmp_path / "set", "-o", output, "--patterns", "gray:20x16",
            "--camera-bin", 2, *more,
        )  # fmt: skip
        assert "by footprints with smooth light" in text
        assert "by the mean picture" in text
    transport = open_transport(output)
    assert transport.noise is not None
    light = transport.relight(np.ones((16, 20), np.float32))
    assert light.shape == (20, 24, 1)
    assert len(counts) == 20
    with pytest.raises(InputError, match=r"gray:20x16.*pictures|pictures.*gray"):
        run("fit", tmp_path / "set", "-o", output, "--patterns", "gray:200x160")


def test_a_dead_light_of_a_dome_is_refused_by_name(tmp_path: Path) -> None:
    row, column = np.indices((24, 24)) / 11.5 - 1
    up = np.sqrt(np.maximum(1 - row**2 - column**2, 0))
    normals = np.stack([column, -row, up])
    angle = np.arange(14) * 2.4
    towards = np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(14, 0.8)], axis=1)
    towards[7:, :2] *= 0.4
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    np.save(tmp_path / "lights.npy", towards)
    light = np.maximum(np.einsum("ij,jhw->ihw", towards, normals), 0) * (up > 0)
    for index, picture in enumerate(light):
        write(tmp_path / f"light_{index:02d}.png", np.rint(230 * picture[..., None]).astype("u1"))
    output = tmp_path / "dome.zarr"
    text = run("fit", tmp_path, "-o", output)
    assert "error in 14 held-out pictures: " in text
    assert open_transport(output).lights.shape == (14, 3)
    write(tmp_path / "light_05.png", np.zeros((24, 24, 1), np.uint8))
    with pytest.raises(InputError, match=r"light_05\.png"):
        run("fit", tmp_path, "-o", output)
    run("fit", tmp_path, "-o", output, "--anyway")


@pytest.mark.parametrize("form", ["1 1 1\n2 2 2\n4 4 4\n", "1\n2\n4\n"])
def test_pictures_are_divided_by_their_lights_intensities(tmp_path: Path, form: str) -> None:
    np.savetxt(tmp_path / "light_directions.txt", np.eye(3) + 0.5)
    (tmp_path / "light_intensities.txt").write_text(form)
    for index, power in enumerate((1, 2, 4)):
        write(tmp_path / f"{index}.tif", np.full((3, 4, 1), 5000 * power, np.uint16))
    radiance = read_series(tmp_path).radiance
    np.testing.assert_allclose(radiance, 5000 / 65535, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "option"), [("black.png", "black"), ("room.png", "ambient")], ids=["black", "ambient"]
)
def test_pictures_darker_than_those_without_light_are_refused(
    tmp_path: Path, name: str, option: str
) -> None:
    for index in range(3):
        write(tmp_path / "set" / f"{index}.png", np.full((4, 5, 1), 40 + index, np.uint8))
    write(tmp_path / name, np.full((4, 5, 1), 10, np.uint8))
    series = read_series(tmp_path / "set", lights=(1, 3), **{option: tmp_path / name})
    np.testing.assert_allclose(series.radiance[:, 0, 0] * 255, [30, 31, 32], rtol=1e-5)
    write(tmp_path / name, np.full((4, 5, 1), 200, np.uint8))
    with pytest.raises(InputError, match="darker than those without light"):
        read_series(tmp_path / "set", lights=(1, 3), **{option: tmp_path / name})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"camera_bin": 100}, r"--camera-bin 100.*at most 20"),
        ({"projector_bin": 9}, r"--projector-bin 9.*at most 8"),
    ],
)
def test_bins_larger_than_the_picture_are_refused(tmp_path: Path, options, message) -> None:
    write_gray_code(tmp_path)
    with pytest.raises(InputError, match=message):
        read_series(tmp_path, patterns="gray:20x16", **options)


@pytest.mark.parametrize(
    ("pictures", "message"),
    [
        (np.full((8, 1, 30), 0.3), "pictures differ by only"),
        (np.random.default_rng(1).random((8, 1, 30)), "mean of the other pictures"),
    ],
    ids=["equal", "noise"],
)
def test_lights_that_predict_nothing_are_refused(pictures: np.ndarray, message: str) -> None:
    angle = np.arange(8) * 2.4
    lights = np.stack([np.cos(angle), np.sin(angle), np.full(8, 1.5)], axis=1)
    radiance = pictures.astype(np.float32)
    eye = np.eye(8, dtype=np.float32)[:, None]
    series = Series((5, 6), (1, 8), eye, radiance, np.zeros_like(radiance), lights=lights)
    with pytest.raises(InputError, match=message):
        fit_transport(series)
