"""Transports of one light at a time that know where their lights are, in the light around."""

from pathlib import Path

import av
import numpy as np
import pytest
from tests.helpers import run

import rfpipe
from rfpipe.errors import InputError
from rfpipe.light_files import LIGHT_FILES
from rfpipe.pictures.images import read_image, write_image

RANDOM = np.random.default_rng(5)
COUNT, SHAPE = 11, (6, 7)
LIGHTS = RANDOM.normal(size=(COUNT, 3)).astype(np.float32)
PICTURES = RANDOM.random((COUNT, *SHAPE, 3), np.float32)


def fitted(folder: Path, name: str = "dome.lp", lights=LIGHTS, *options: object):
    """What `fit` makes of pictures, and lights that an .lp names in another order than theirs."""
    for index, picture in enumerate(PICTURES):
        write_image(folder / f"light_{index}.exr", picture)
    (np.save if name.endswith("npy") else np.savetxt)(folder / name, lights)
    if name.endswith("lp"):
        lines = (folder / name).read_text().splitlines()
        named = [f"C:\\a day\\Light_{index}.JPG {line}\n" for index, line in enumerate(lines)]
        (folder / name).write_text(f"{len(lines)}\n{''.join(named[::-1])}")
    run("fit", folder, "-o", folder / "dome.zarr", *options)
    return rfpipe.open_transport(folder / "dome.zarr")


@pytest.mark.parametrize("name", [name.replace("[!.]*", "dome") for name in LIGHT_FILES])
def test_a_folder_s_file_of_lights_stays_with_the_transport(tmp_path: Path, name: str) -> None:
    transport = fitted(tmp_path, name)
    np.testing.assert_array_equal(transport.lights, LIGHTS)
    some = rfpipe.crop(transport, np.s_[2:4, :], np.s_[:, 3::2])
    np.testing.assert_array_equal(some.lights, LIGHTS[3::2])
    assert transport.T.lights is rfpipe.coarser(transport, 2).lights is None


def test_a_map_that_shines_from_one_light_gives_its_picture(tmp_path: Path) -> None:
    transport, height = fitted(tmp_path), 40
    for row, column in ((3, 50), (20, 0), (39, 79)):
        panorama = np.zeros((height, 2 * height, 3), np.float32)
        panorama[row, column] = radiance = (3, 2, 1)
        down, right = np.pi * (row + 0.5) / height, np.pi * ((column + 0.5) / height - 1)
        way = [np.sin(down) * np.sin(right), np.cos(down), np.sin(down) * np.cos(right)]
        light = np.argmax(LIGHTS @ way / np.linalg.norm(LIGHTS, axis=1))
        around = 2 * np.pi * np.diff(-np.cos(np.pi * np.array([row, row + 1]) / height))
        expected = PICTURES[light] * radiance * around / (2 * height)
        found = transport.relight_environment(np.roll(panorama, 20, 1), turned=-90)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * expected.max())


def test_a_map_that_shines_alike_keeps_its_energy_as_it_turns() -> None:
    rig = rfpipe.OperatorRig(np.ones((42, COUNT)), SHAPE, (1, COUNT))
    transport = rfpipe.acquire(rig, "dual", progress=False).transport
    transport.lights, rgb = LIGHTS, np.array([3, 2, 1])
    for turned in (0, 77):
        found = transport.truncate(1).relight_environment(rgb + np.zeros((8, 16, 1)), None, turned)
        np.testing.assert_allclose(found / rgb, np.full((*SHAPE, 3), 4 * np.pi), rtol=1e-5)


def test_a_panorama_that_turns_as_a_movie_and_as_pictures(tmp_path: Path) -> None:
    transport, sky = fitted(tmp_path), RANDOM.random((8, 16, 3), np.float32)
    write_image(tmp_path / "sky.exr", sky)
    command = ["relight", tmp_path / "dome.zarr", "--environment", tmp_path / "sky.exr", "--turns"]
    run(*command, 4, "-o", tmp_path / "sky.mp4")
    with av.open(str(tmp_path / "sky.mp4")) as container:
        assert len(list(container.decode(video=0))) == 4
    run(*command, 4, "-o", tmp_path / "sky")
    with pytest.raises(InputError, match="for 4 pictures"):
        run(*command, 4, "-o", tmp_path / "sky.gif")
    expected = transport.relight_environment(sky, turned=90)
    np.testing.assert_allclose(read_image(tmp_path / "sky/sky_0001.exr"), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("lights", "options", "message"),
    [
        (LIGHTS[1:], (), "10 directions of lights for 11|no line for the picture light_10"),
        (LIGHTS[1:], ("--lights", 1, 11), "10 directions.* for 11|no line for .* light_10"),
        (np.where(np.eye(COUNT, 1, -4), 0, LIGHTS), (), "has no direction"),
        (np.where(np.eye(COUNT, 1, -4), np.nan, LIGHTS), (), "has no direction"),
        (LIGHTS[:, :2], (), r"three numbers|\(lights, 3\)"),
    ],
)
@pytest.mark.parametrize("name", ["dome.lp", "light_pos.npy"])
def test_lights_of_no_pictures_are_refused(tmp_path, name, lights, options, message) -> None:
    with pytest.raises(InputError, match=message):
        fitted(tmp_path, name, lights, *options)
    assert not (tmp_path / "dome.zarr").exists()


def test_maps_and_transports_that_don_t_fit_are_refused(tmp_path: Path) -> None:
    transport, sky = fitted(tmp_path), tmp_path / "sky.exr"
    command = ["relight", tmp_path / "dome.zarr", "--environment", sky, "-o", tmp_path / "a.exr"]
    transport.lights = None
    transport.save(tmp_path / "dome.zarr")
    for panorama, message in (
        (np.ones((8, 8, 3)), "sky.exr: an array .* twice as wide as high"),
        (np.full((8, 16, 3), np.nan), "sky.exr: holds NaN"),
        (-np.ones((8, 16, 3)), "sky.exr: .* negative"),
        (np.ones((8, 16, 3)), "doesn't know where its lights are"),
    ):
        write_image(sky, panorama)
        with pytest.raises(InputError, match=message):
            run(*command)
    (tmp_path / "dome.lp").write_text("7\n0 0 1\n")
    with pytest.raises(InputError, match="counts 7 lights, it has 1"):
        rfpipe.read_lights(tmp_path / "dome.lp")
