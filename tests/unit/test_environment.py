"""Relighting of one-light-at-a-time transports with environment maps."""

from pathlib import Path

import av
import numpy as np
import pytest
from tests.rigs.known_matrix import run

import rfpipe
from rfpipe.errors import InputError
from rfpipe.light_files import LIGHT_FILES
from rfpipe.pictures.images import read_image, write_image

RANDOM = np.random.default_rng(5)
COUNT, SHAPE = 11, (6, 7)
LIGHTS = RANDOM.normal(size=(COUNT, 3)).astype(np.float32)
PICTURES = RANDOM.random((COUNT, *SHAPE, 3), np.float32)


def fitted(folder: Path, name: str = "dome.lp", lights=LIGHTS, *options: object):
    """Return a transport fitted to pictures and lights in different orders."""
    for index, picture in enumerate(PICTURES):
        write_image(folder / f"light_{index}.exr", picture)
    (np.save if name.endswith("npy") else np.savetxt)(folder / name, lights)
    if name.endswith("lp"):
        lines = (folder / name).read_text().splitlines()
        named = [f"C:\\a day\\Light_{index}.JPG {line}\n" for index, line in enumerate(lines)]
        (folder / name).write_text(f"{len(lines)}\n{''.join(named[::-1])}")
    # the pictures are noise, so other lights do not predict them
    run("fit", folder, "-o", folder / "dome.zarr", "--anyway", *options)
    return rfpipe.open_transport(folder / "dome.zarr")


@pytest.mark.parametrize("name", [name.replace("[!.]*", "dome") for name in LIGHT_FILES])
def test_a_fitted_transport_keeps_the_directions_of_its_lights(tmp_path: Path, name: str) -> None:
    transport = fitted(tmp_path, name)
    np.testing.assert_array_equal(transport.lights, LIGHTS)
    subset = rfpipe.crop(transport, np.s_[2:4, :], np.s_[:, 3::2])
    np.testing.assert_array_equal(subset.lights, LIGHTS[3::2])
    assert transport.T.lights is rfpipe.coarser(transport, 2).lights is None


def sun(direction, height: int, *, mirrored: bool = False):
    """Return a panorama with one lit pixel, in OpenEXR's convention, and the pixel's direction."""
    x, y, z = np.asarray(direction) / np.linalg.norm(direction)
    longitude = np.arctan2(x, z)  # 0 in the centre, pi / 2, +x, left of it
    row = int(np.arccos(y) / np.pi * height)
    column = int((0.5 - (-1 if mirrored else 1) * longitude / (2 * np.pi)) * 2 * height)
    panorama = np.zeros((height, 2 * height, 3), np.float32)
    panorama[row, column] = 3, 2, 1
    solid_angle = np.pi / height * -np.diff(np.cos(np.pi * np.array([row, row + 1]) / height))
    return panorama, solid_angle


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turned", [0, -90])
def test_a_single_lit_pixel_in_the_direction_of_a_light_gives_its_picture(
    tmp_path: Path, mirrored, turned
) -> None:
    transport, height = fitted(tmp_path), 400
    for light in (0, 4, 7):
        panorama, solid_angle = sun(LIGHTS[light], height, mirrored=mirrored)
        panorama = np.roll(panorama, -2 * height * turned // 360, axis=1)
        image = transport.relight_environment(panorama, turned=turned, mirrored=mirrored)
        expected = PICTURES[light] * [3, 2, 1] * np.abs(solid_angle)
        np.testing.assert_allclose(image, expected, rtol=1e-4, atol=1e-5 * expected.max())


@pytest.mark.parametrize(
    ("row", "column", "axis"),
    [(8, 8, 0), (8, 24, 3), (0, 5, 1), (15, 5, 4), (8, 16, 2), (8, 0, 5)],
    ids=["left", "right", "top", "bottom", "centre", "edge"],
)
def test_panoramas_have_the_orientation_of_openexr(row: int, column: int, axis: int) -> None:
    # latitude pi/2 and longitude pi in the upper left; longitude 0 is +z, pi/2 is +x
    lights = np.concatenate([np.eye(3), -np.eye(3)])
    panorama = np.zeros((16, 32))
    panorama[row, column] = 1
    for mirrored, expected in ((False, axis), (True, {0: 3, 3: 0}.get(axis, axis))):
        weights = rfpipe.environment_weights(panorama, lights, mirrored=mirrored)
        assert weights[:, 0].argmax() == expected


def test_coverage_of_the_lights_and_mirrored_maps(tmp_path: Path) -> None:
    lights = np.abs(LIGHTS) * [1, 1, 3]
    transport = fitted(tmp_path, "dome.lp", lights)
    sky = np.zeros((32, 64, 3), np.float32)
    sky[10:14, 36:40], sky[16, :4] = 1, 0.5  # before the object, and behind it
    write_image(tmp_path / "sky.exr", sky)
    command = ["relight", tmp_path / "dome.zarr", "--environment", tmp_path / "sky.exr"]
    output = run(*command, "--mirror", "-o", tmp_path / "a.exr")
    missing = 1 - rfpipe.environment_coverage(sky, lights, mirrored=True)
    area = np.cos(np.pi * ((np.arange(32) + 0.5) / 32 - 0.5))
    light_behind = 0.5 * 4 * area[16]
    assert missing == pytest.approx(light_behind / (light_behind + 4 * area[10:14].sum()), rel=1e-3)
    assert f"{missing:.1%} of its light is omitted" in output
    expected = transport.relight_environment(sky, mirrored=True)
    np.testing.assert_allclose(read_image(tmp_path / "a.exr"), expected, rtol=1e-5)
    assert not np.allclose(transport.relight_environment(sky), expected, rtol=1e-2)


def test_exported_lights_keep_their_directions(tmp_path: Path) -> None:
    transport = fitted(tmp_path)
    (tmp_path / "out").mkdir()
    run("export", tmp_path / "dome.zarr", "-o", tmp_path / "out/olat.exr")
    run("fit", tmp_path / "out", "-o", tmp_path / "again.zarr", "--anyway")
    repeated = rfpipe.open_transport(tmp_path / "again.zarr")
    unit = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)
    np.testing.assert_allclose(repeated.lights, unit, atol=1e-6)
    np.testing.assert_allclose(repeated.toarray(), transport.toarray(), atol=1e-6)
    transport.lights = None
    transport.save(tmp_path / "dome.zarr")
    run("export", tmp_path / "dome.zarr", "-o", tmp_path / "out/olat.exr")
    assert not (tmp_path / "out/olat.lp").exists()


def test_a_uniform_map_keeps_its_energy_when_rotated() -> None:
    rig = rfpipe.OperatorRig(np.ones((42, COUNT)), SHAPE, (1, COUNT))
    transport = rfpipe.acquire(rig, "dual", progress=False).transport
    transport.lights, rgb = LIGHTS, np.array([3, 2, 1])
    for turned in (0, 77):
        result = transport.truncate(1).relight_environment(rgb + np.zeros((8, 16, 1)), None, turned)
        np.testing.assert_allclose(result / rgb, np.full((*SHAPE, 3), 4 * np.pi), rtol=1e-5)


def test_a_rotating_panorama_is_written_as_movie_and_pictures(tmp_path: Path) -> None:
    transport, sky = fitted(tmp_path), RANDOM.random((8, 16, 3), np.float32)
    write_image(tmp_path / "sky.exr", sky)
    command = ["relight", tmp_path / "dome.zarr", "--environment", tmp_path / "sky.exr", "--turns"]
    run(*command, 4, "-o", tmp_path / "sky.mp4")
    with av.open(str(tmp_path / "sky.mp4")) as container:
        assert len(list(container.decode(video=0))) == 4
    run(*command, 4, "-o", tmp_path / "sky")
    with pytest.raises(InputError, match="can't contain 4 pictures"):
        run(*command, 4, "-o", tmp_path / "sky.png")
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
def test_lights_without_pictures_are_refused(tmp_path, name, lights, options, message) -> None:
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
        (np.ones((8, 16, 3)), "has no directions of its lights"),
    ):
        write_image(sky, panorama)
        with pytest.raises(InputError, match=message):
            run(*command)
    (tmp_path / "dome.lp").write_text("7\n0 0 1\n")
    with pytest.raises(InputError, match="counts 7 lights, it has 1"):
        rfpipe.read_lights(tmp_path / "dome.lp")
