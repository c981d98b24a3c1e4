"""Fits of a transport to existing pictures of known patterns."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import yaml
from scipy.linalg import hadamard
from tests.rigs.known_matrix import dense, picture_error, run

from rfpipe import open_transport
from rfpipe.config import CameraConfig
from rfpipe.errors import InputError
from rfpipe.export import photographs
from rfpipe.fitting import Series, fit_transport, read_series
from rfpipe.photometry import CameraModel
from rfpipe.pictures import read_picture
from rfpipe.scenes import planes_scene, relighting_patterns
from rfpipe.transport.dense import DenseTransport

SHAPE = (12, 14)
WALL = {"kind": "plane", "surfaces": ["white"]}
RAYS = 168
SCENE = planes_scene("wedge", ("white", "texture"), shape=SHAPE)
T = np.stack([SCENE.dense(channel) for channel in range(3)])


def series(patterns: np.ndarray, noise: float = 0.0, seed: int = 0) -> Series:
    """Return pictures with noise: a standard deviation relative to the mean light."""
    light = np.einsum("cmn,kn->kcm", T, patterns)
    spread = np.full_like(light, (noise * light.mean()) ** 2)
    observed = light + np.sqrt(spread) * np.random.default_rng(seed).standard_normal(light.shape)
    return Series(SHAPE, SHAPE, *(a.astype(np.float32) for a in (patterns, observed, spread)))


def error_of(transport) -> float:
    """Return the mean relighting error under the reference patterns."""
    lit = np.stack(list(relighting_patterns(SHAPE).values()))
    return picture_error(transport, T, lit)


def test_one_light_at_a_time_becomes_the_transport() -> None:
    result = fit_transport(series(np.eye(RAYS)))
    assert result.complete
    assert result.error is None  # too few pictures to estimate it
    np.testing.assert_allclose(dense(result.transport), T, rtol=1e-5, atol=1e-6 * T.max())


def test_hadamard_patterns_determine_the_transport_up_to_noise() -> None:
    patterns = (hadamard(256)[:, :RAYS] > 0).astype(float)
    assert error_of(fit_transport(series(patterns)).transport) < 1e-4
    result = fit_transport(series(patterns, noise=0.01))
    assert result.transport.history.estimated_error.iloc[-1] == result.error < 0.05
    assert result.held_out == 16  # the remaining patterns still determine the transport
    assert result.complete


def test_few_pictures_of_a_coaxial_rig_select_near_far() -> None:
    random = np.random.default_rng(1).random((40, RAYS)) < 0.5
    few = series(np.concatenate([np.ones((1, RAYS)), random]), noise=0.003)
    result = fit_transport(few, coaxial=True)
    assert (result.model, result.held_out) == ("near/far", 5)
    assert result.error == min(result.errors.values())
    assert fit_transport(few).model == "footprints with smooth light"
    error = error_of(result.transport)
    assert error / 3 < result.error < 3 * error
    assert error < 0.02
    with pytest.raises(InputError, match="white light"):
        fit_transport(few.some(np.arange(1, 41)), coaxial=True)


@pytest.mark.parametrize(
    ("count", "takes", "message"),
    [
        (240, [3, 1, 2, 0], r"exchanged: 0\.exr with 3\.exr"),
        (
            40,
            [*range(1, 40), 0],
            r"by the mean picture, .* with \d+%.*order than the patterns",
        ),
    ],
)
def test_fit_refuses_contradictory_pictures(
    tmp_path: Path, count: int, takes: list[int], message: str
) -> None:
    patterns = np.random.default_rng(5).random((count, *SHAPE)) < 0.5
    np.save(tmp_path / "patterns.npy", patterns)
    radiance = series(patterns.reshape(count, RAYS)).radiance
    for index, picture in enumerate([*takes, *range(len(takes), count)]):
        write(tmp_path / f"{index}.exr", np.moveaxis(radiance[picture], 0, -1).reshape(*SHAPE, 3))
    with pytest.raises(InputError, match=message):
        run("fit", tmp_path, "-o", tmp_path / "t.zarr")
    assert not (tmp_path / "t.zarr").exists()
    run("fit", tmp_path, "-o", tmp_path / "t.zarr", "--anyway")


def write(path: Path, pixels: np.ndarray, seconds: float | None = None) -> None:
    path.parent.mkdir(exist_ok=True, parents=True)
    picture = oiio.ImageBuf(np.ascontiguousarray(pixels))
    if seconds:
        picture.specmod().attribute("ExposureTime", seconds)
    assert picture.write(str(path)), picture.geterror()


def test_a_foreign_folder_of_single_lights(tmp_path: Path) -> None:
    """A folder of a light stage: EXR pictures, and lights without a grid."""
    lights = np.random.default_rng(3).random((7, *SHAPE, 3), np.float32)
    for index, light in enumerate(lights):
        write(tmp_path / "stage" / f"light_{index}.exr", light)
    output = tmp_path / "out.zarr"
    output_text = run("fit", tmp_path / "stage", "-o", output, "--lights", 1, 7)
    assert "7 pictures of 7 projector rays (complete)" in output_text
    assert "the error is unknown" in output_text
    transport = open_transport(output)
    assert (transport.camera_shape, transport.projector_shape) == (SHAPE, (1, 7))
    weights = np.array([[0, 1, 0, 0, 0.5, 0, 0]], np.float32)
    np.testing.assert_allclose(transport.relight(weights), lights[1] + 0.5 * lights[4], rtol=1e-5)
    with pytest.raises(InputError, match="7 pictures of 8 patterns"):
        read_series(tmp_path / "stage", lights=(2, 4))


def test_brackets_of_a_known_camera_bring_their_variance(tmp_path: Path) -> None:
    numbers = {"exposures": [0.02, 0.2], "bits": 16, "black_level_counts": 500}
    camera = CameraModel(**CameraConfig(**numbers).model_dump())
    patterns = np.eye(6, dtype=np.float32).reshape(6, 2, 3)
    patterns = np.concatenate([np.zeros((2, 2, 3), np.float32), patterns])
    np.save(tmp_path / "patterns.npy", patterns)
    matrix = np.random.default_rng(4).random((20, 6)).astype(np.float32)
    for index, pattern in enumerate(patterns):
        radiance = (matrix @ pattern.ravel()).reshape(4, 5, 1)
        for exposure, frame in enumerate(camera.expose(radiance, 1, (0, index))):
            write(tmp_path / "pictures" / f"{2 * index + exposure}.tif", frame)
    read_back = read_series(tmp_path, camera=camera)
    assert read_back.patterns.shape == (6, 1, 6)  # without the black pictures, which are subtracted
    deviation = (read_back.radiance[:, 0] - matrix.T) / np.sqrt(read_back.variance[:, 0])
    assert 0.7 < deviation.std() < 1.4
    (tmp_path / "c.yaml").write_text(yaml.safe_dump({"scenes": {"a": WALL}, "camera": numbers}))
    output_text = run("fit", tmp_path, "-o", tmp_path / "t.zarr", "--settings", tmp_path / "c.yaml")
    assert "6 pictures of 6 projector rays (complete)" in output_text


def test_exposure_times_and_transfer_of_plain_pictures(tmp_path: Path) -> None:
    for index, seconds in enumerate((0.5, 0.25)):
        write(tmp_path / f"{index}.png", np.full((2, 2, 1), 128, np.uint8), seconds)
    read_back = read_series(tmp_path, lights=(1, 2), transfer="srgb")
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(
        read_back.radiance[:, 0, 0], [linear / 0.5, linear / 0.25], rtol=1e-5
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: np.save(folder / "patterns.npy", np.ones((3, 2, 2))), "2 pictures of 3"),
        (lambda folder: np.save(folder / "patterns.npy", -np.ones((2, 2, 2))), "not negative"),
        (
            lambda folder: write(folder / "1.exr", np.ones((3, 2, 1), np.float32)),
            "should be alike",
        ),
        (lambda folder: None, "has no patterns"),
    ],
)
def test_mistakes_in_a_folder_are_reported(tmp_path: Path, change, message: str) -> None:
    for index in range(2):
        write(tmp_path / f"{index}.exr", np.ones((2, 2, 1), np.float32))
    if message == "should be alike":
        np.save(tmp_path / "patterns.npy", np.ones((2, 2, 2)))
    change(tmp_path)
    with pytest.raises(InputError, match=message):
        read_series(tmp_path)


# --- pictures of other programs: parts of an EXR file, folders of papers


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stored") / "t.zarr"
    DenseTransport(SHAPE, SHAPE, 3, [], {"matrix": T.astype(np.float32)}).save(path)
    return path


def test_lights_are_exported_and_read_as_parts_of_an_exr_file(tmp_path: Path, stored: Path) -> None:
    file, fitted = tmp_path / "olat.exr", tmp_path / "fitted.zarr"
    assert "168 lights of 12 x 14" in run("export", stored, "-o", file)
    assert "(complete)" in run("fit", file, "-o", fitted, "--lights", 12, 14)
    np.testing.assert_allclose(open_transport(fitted).toarray(), T, rtol=1e-5, atol=1e-6 * T.max())
    run("export", stored, "-o", file, "--coarser", 4, "--columns", "2,:3")
    read_back = read_series(file)
    assert list(read_back.names) == ["light_2_0", "light_2_1", "light_2_2"]
    assert read_back.projector_shape == (1, 3)
    lit = T.reshape(3, RAYS, *SHAPE)[..., 8:12, :4].sum((2, 3))
    np.testing.assert_allclose(read_back.radiance[0], lit, rtol=1e-5)
    np.save(tmp_path / "patterns.npy", hadamard(4)[1:, None] > 0)  # with parts, in a folder
    assert list(read_series(tmp_path).names) == list(read_back.names)


def test_lights_that_can_t_be_written_are_refused(tmp_path: Path, stored: Path) -> None:
    large = r"168 x 12 x 14 x 3 entries takes 0.3 MiB, the limit is 0.1"
    for option, value, message in (
        ("--limit-gib", 1e-4, large), ("--rows", "1,:", "all cam"), ("--columns", "12,0", "outside")
    ):  # fmt: skip
        with pytest.raises(InputError, match=message):
            run("export", stored, "-o", tmp_path / "olat.exr", option, value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [("a.exr",), ("setup", "--photographs", 2, 1)])
def test_an_interrupted_export_leaves_nothing(
    tmp_path: Path, stored: Path, monkeypatch, options
) -> None:
    relit = iter(np.ones((4, *SHAPE, 3)))
    stopping = lambda _light, patterns: (next(relit) for _ in patterns)  # noqa: E731
    monkeypatch.setattr(photographs, "relit_pictures", stopping)
    with pytest.raises(RuntimeError, match="StopIteration"):
        run("export", stored, "-o", tmp_path / options[0], *options[1:])
    assert not list(tmp_path.iterdir())


def test_parts_of_other_programs_keep_their_order_or_are_refused(tmp_path: Path) -> None:
    file, pictures = tmp_path / "lights.exr", np.random.default_rng(6).random((3, 4, 5, 3))
    specs = [oiio.ImageSpec(5, 4, 3, "half") for _ in range(3)]
    for spec, name in zip(specs, ("rim", "fill", "key"), strict=True):
        spec.channelnames = tuple(f"{name}.{colour}" for colour in "RGB")
        spec.attribute("oiio:subimagename", name)

    def write_them(pictures=pictures) -> None:
        out = oiio.ImageOutput.create(str(file))
        assert out.open(str(file), specs)
        for index, (picture, spec) in enumerate(zip(pictures, specs, strict=True)):
            assert not index or out.open(str(file), spec, "AppendSubimage")
            assert out.write_image(picture[..., : spec.nchannels])
        out.close()

    write_them()
    read_back = read_series(file)
    assert list(read_back.names) == ["rim", "fill", "key"]
    np.testing.assert_allclose(read_back.radiance[2], pictures[2].reshape(20, 3).T, rtol=1e-3)
    with pytest.raises(InputError, match="3 pictures of 4 patterns"):
        read_series(file, lights=(2, 2))
    with pytest.raises(InputError, match="holds 3 pictures, as parts"):
        read_picture(file)
    write_them(np.where(np.arange(3)[:, None, None, None] == 1, np.nan, pictures))
    with pytest.raises(InputError, match="part fill: holds NaN"):
        read_series(file)
    write(file, np.ones((4, 5, 3), np.float32))
    with pytest.raises(InputError, match="holds one picture"):
        read_series(file)
    cropped = oiio.ImageSpec(3, 4, 3, "half")
    cropped.x, cropped.full_width, specs[1] = 2, 5, cropped
    cropped.attribute("oiio:subimagename", "fill")
    write_them([np.ones((spec.height, spec.width, 3)) for spec in specs])
    columns = read_series(file).radiance[1, 0].reshape(4, 5)
    np.testing.assert_array_equal(columns, np.broadcast_to([0, 0, 1, 1, 1], (4, 5)))
    specs[1] = oiio.ImageSpec(5, 4, 1, "half")
    specs[1].attribute("oiio:subimagename", "fill")
    write_them([np.ones((spec.height, spec.width, 3)) for spec in specs])
    with pytest.raises(InputError, match=r"part fill: has 4 x 5 pixels.*should be alike"):
        read_series(file)


@pytest.mark.parametrize(
    ("form", "error"), [pytest.param("exr", 1e-5, marks=pytest.mark.slow), ("png", 0.01)]
)
def test_photographs_in_the_layout_of_papers_are_read_as_written(
    tmp_path: Path, stored: Path, form: str, error: float
) -> None:
    folder = tmp_path / "setup"
    output_text = run("export", stored, "-o", folder, "--photographs", 250, 30, "--format", form)
    series = read_series(folder)
    assert (len(series.patterns), series.validation.sum()) == (282, 30)  # black is subtracted
    result = fit_transport(series)
    assert (result.complete, result.held_out) == (True, 30)
    assert result.error < error
    white = float(output_text.split()[-1]) if form == "png" else 1.0
    assert np.linalg.norm(white * dense(result.transport) - T) < 2 * error * np.linalg.norm(T)
    with pytest.raises(InputError, match="exists already"):
        run("export", stored, "-o", folder, "--photographs", 2, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda at: (at / "cam/raw/train/img_0003.exr").unlink(), "7 pictures.*8 pat.*img_0003"),
        (lambda at: (at / "test/img_0002.exr").unlink(), "2 pictures for the 1 patterns.*img_0002"),
        (lambda at: write(at / "train/img_0004.exr", np.ones((12, 13, 3), "f4")), "another size"),
        (lambda at: write(at / "cam/raw/test/img_0001.exr", np.ones((9, 9, 3), "f4")), "be alike"),
        (lambda at: shutil.rmtree(at / "train"), "train: is not a folder"),
    ],
)
def test_folders_of_papers_with_mistakes_are_refused(
    tmp_path: Path, stored: Path, change, message
) -> None:
    folder = tmp_path / "setup"
    run("export", stored, "-o", folder, "--photographs", 8, 2, "--format", "exr", "--seed", 1)
    change(folder)
    with pytest.raises(InputError, match=message):
        read_series(folder)
