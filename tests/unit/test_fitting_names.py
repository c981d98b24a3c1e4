"""Roles of files by their names: pictures, mask, ambient light, results and patterns.npy."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from tests.files.dng import dng_bytes

from rfpipe.errors import InputError
from rfpipe.fitting.folder import list_pictures
from rfpipe.fitting.names import sort_pictures
from rfpipe.pictures.images import write_image

LIGHTS = "a.jpg 0 0 1\nb.jpg 0 1 1\nc.jpg 1 0 1\n"


def folder_of(folder: Path, *names: str, lights: str | None = LIGHTS) -> Path:
    folder.mkdir(exist_ok=True)
    for index, name in enumerate(names):
        write_image(folder / name, np.random.default_rng(index).random((4, 5, 3), np.float32))
    if lights:
        (folder / "dome.lp").write_text(lights)
    return folder


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("mask.png", "mask"), ("Mask.PNG", "mask"), ("cat.mask.png", "mask"),
        ("cat_mask.png", "mask"), ("unmasked_1.png", "pictures"), ("masks_1.png", "pictures"),
        ("ambient.png", "ambient"), ("vase_ambient.tif", "ambient"),
        ("vase.Ambient.exr", "ambient"), ("ambience.png", "pictures"),
        ("normals.png", "ignored"), ("Normal_gt.png", "ignored"), ("cat.normals.exr", "ignored"),
        ("normal-map.png", "ignored"), ("albedo.png", "ignored"), ("normal_1.png", "pictures"),
    ],
)  # fmt: skip
def test_names_have_roles(name: str, role: str) -> None:
    files = [Path("a.png"), Path(name)]
    roles = sort_pictures(files)
    assert Path(name) in np.atleast_1d(getattr(roles, role))
    assert Path("a.png") in roles.pictures
    assert sort_pictures(files, ["a", name.replace("png", "jpg")]).pictures == (*files,)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["a.png", "cat.mask.png", "mask.png"], r"cat\.mask\.png and mask\.png are both masks"),
        (["mask.png", "ambient.png"], r"no pictures of patterns or lights, only mask\.png"),
    ],
)
def test_ambiguous_names_are_refused(names: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        sort_pictures([*map(Path, names)])


@pytest.mark.parametrize("has_names", [True, False])
def test_other_files_may_be_beside_the_pictures_of_a_dome(tmp_path: Path, has_names: bool) -> None:
    lights = LIGHTS if has_names else "3\n0 0 1\n0 1 1\n1 0 1\n"
    folder = folder_of(
        tmp_path, "a.png", "b.png", "c.png", "ambient.png", "cat.mask.png", "normals.png",
        lights=lights,
    )  # fmt: skip
    (folder / "light_intensities.txt").write_text("1\n2\n4\n")
    listing = list_pictures(folder)
    assert [bracket[0].name for bracket in listing.brackets] == ["a.png", "b.png", "c.png"]
    assert len(listing.patterns) == 3
    assert listing.directions.tolist() == [[0, 0, 1], [0, 1, 1], [1, 0, 1]]
    assert listing.intensities.tolist() == [[1], [2], [4]]
    assert listing.mask.name == "cat.mask.png"
    assert [part.name for [part] in listing.dark] == ["ambient.png"]
    assert [note.partition(": ")[2][:8] for note in listing.notes] == [
        "taken as", "subtract", "left out",
    ]  # fmt: skip


def test_the_black_picture_may_be_beside_the_others(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "a.png", "b.png", "c.png", "dark.png")
    listing = list_pictures(folder, black=folder / "dark.png")
    assert len(listing.brackets) == 3
    with pytest.raises(InputError, match=r"no line for the picture dark\.png"):
        list_pictures(folder)


def test_doubled_pictures_are_noted_or_refused(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "a.png", "b.png", lights="a 0 0 1\nb 0 1 1\nc 1 0 1\n")
    shutil.copy(folder / "a.png", folder / "c.png")
    (note,) = list_pictures(folder).notes
    assert "a.png, c.png: are the same picture" in note
    write_image(folder / "c.exr", np.ones((4, 5, 3), np.float32))
    with pytest.raises(InputError, match=r"c\.png: has the name of c\.exr with another suffix"):
        list_pictures(folder)


@pytest.mark.parametrize(("develop_raw", "channels"), [(False, 1), (True, 3)])
def test_raw_files_are_developed_without_a_camera(tmp_path, develop_raw, channels) -> None:
    for index in range(2):
        mosaic = np.full((32, 48), 1000 * (index + 1), np.uint16)
        (tmp_path / f"{index}.dng").write_bytes(dng_bytes(mosaic, 0.25))
    listing = list_pictures(tmp_path, lights=(1, 2), develop_raw=develop_raw)
    assert [part.header.channels for [part] in listing.brackets] == [channels] * 2


def test_lights_of_two_objects_in_the_folder_that_contains_them(tmp_path: Path) -> None:
    (tmp_path / "lights.txt").write_text("3\n0 0 1\n0 1 1\n1 0 1\n")
    cat = folder_of(tmp_path / "cat", "cat.0.png", "cat.1.png", "cat.2.png", lights=None)
    listing = list_pictures(cat)
    assert listing.directions.tolist() == [[0, 0, 1], [0, 1, 1], [1, 0, 1]]
    assert f"from the folder above, {tmp_path / 'lights.txt'}" in listing.notes[-1]
    np.save(cat / "patterns.npy", np.ones((3, 2, 2)))
    assert list_pictures(cat).directions is None
    gray = folder_of(tmp_path / "gray", "gray.0.png", "gray.1.png", lights=None)
    with pytest.raises(InputError, match=r"lights\.txt: 3 directions of lights for 2 pictures"):
        list_pictures(gray)


ONES = np.array([[[1, 0], [0, 1]], [[1, 1], [0, 0]], [[0, 1], [0, 1]]])


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (255 * ONES.astype(np.uint8), r"uint8 with values from 0 to 255.*fractions"),
        (65535 * ONES.astype(np.uint16), "0 to 65535"),
        (2 * ONES, "0 to 2"),
        (255.0 * ONES, "whole numbers up to 255.*divide"),
        (4095 * ONES.astype(np.float32), "whole numbers up to 4095"),
        (ONES + 0j, "complex128"),
        (ONES - 1.0, "not negative"),
        (np.where(ONES, np.nan, 1), "finite"),
        (ONES[0], r"array \(2, 2\)"),
        (np.full((3, 2, 2), "1"), "<U1"),
    ],
)
def test_invalid_weights_are_refused(tmp_path: Path, weights, message: str) -> None:
    folder = folder_of(tmp_path, "a.png", "b.png", "c.png", lights=None)
    np.save(folder / "patterns.npy", weights)
    with pytest.raises(InputError, match=r"patterns\.npy.*(?:" + message + ")"):
        list_pictures(folder)


@pytest.mark.parametrize(
    ("weights", "note"),
    [(ONES, None), (ONES > 0, None), (ONES / 2, None), (3.5 * ONES, "weights up to 3.5")],
)
def test_valid_weights_are_accepted(tmp_path: Path, weights, note: str | None) -> None:
    folder = folder_of(tmp_path, "a.png", "b.png", "c.png", lights=None)
    np.save(folder / "patterns.npy", weights)
    listing = list_pictures(folder)
    for read, expected in zip(listing.patterns.readers, weights, strict=True):
        np.testing.assert_array_equal(read(), expected)
    assert note in " ".join(listing.notes) if note else not listing.notes


def test_a_file_without_an_array_is_refused(tmp_path: Path) -> None:
    folder = folder_of(tmp_path, "a.png", lights=None)
    (folder / "patterns.npy").write_bytes(b"cut")
    with pytest.raises(InputError, match=r"patterns\.npy: can't be read"):
        list_pictures(folder)
