"""Files of lights: the picture of each line, and the numbers of its direction."""

from pathlib import Path
from unicodedata import normalize

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import InputError
from rfpipe.light_files import intensities_in, light_names_in, lights_in

A, B, C = (0.5, 0.3, 0.8), (0.0, 0.0, 1.0), (0.6, 0.8, 0.0)
PICTURES = ("a.tif", "b.tif", "c.tif")
COMPOSED, DECOMPOSED = (normalize(form, "gr\u00fcn.tif") for form in ("NFC", "NFD"))

READ = {
    "RTI": "3\nb.jpg 0 0 1\nc.jpg .6 .8 0\na.jpg 0.5 0.3 0.8\n",
    "no count": "b.jpg 0 0 1\nc.jpg .6 .8 0\na.jpg 5e-1 0.3 0.8",
    "folders and case": "3\nC:\\my dome\\A.JPG .5 .3 .8\n../x/B.Jpg 0 0 1\n./C.cr2 .6 .8 0\n",
    "no endings": "3\nb 0 0 1\nc .6 .8 0\na .5 .3 .8\n",
    "no names": "3\n.5 .3 .8\n0 0 1\n.6 .8 0\n",
    "more lines than pictures": "d.jpg 1 0 0\nb.jpg 0 0 1\nc.jpg .6 .8 0\na.jpg .5 .3 .8\n",
    "tabs": "3\na.tif\t.5\t.3\t.8\nb.tif\t0\t0\t1\nc.tif\t.6\t.8\t0\n",
    "commas": "3\na.tif,0.5,0.3,0.8\nb.tif,0,0,1\nc.tif, .6, .8, 0\n",
    "semicolons": "3;\na.tif;.5;.3;.8\nb.tif; 0; 0; 1\nc.tif;.6;.8;0\n",
    "decimal commas": "3\na.tif 0,5 0,3 0,8\nb.tif 0 0 1\nc.tif 0,6 0,8 0,0\n",
    "decimal commas, no endings": "a 0,5 0,3 0,8\nb 0,0 0,0 1,0\nc 0,6 0,8 0\n",
    "decimal commas and semicolons": "0,5; 0,3; 0,8\n0; 0; 1\n0,6; 0,8; 0\n",
    "decimal commas and commas": "a.tif 0,5, 0,3, 0,8\nb.tif 0, 0, 1\nc.tif 0,6, 0,8, 0\n",
    "comments": "# dome\n3 // lights\na.tif .5 .3 .8 # upper\n\n// off\nb.tif 0 0 1\nc.tif .6 .8 0",
    "intensities": "a.tif .5 .3 .8 2\nb.tif 0 0 1 3\nc.tif .6 .8 0 4\n",
    "colours": "a.tif .5 .3 .8 1 .5 .25\nb.tif 0 0 1 1 .5 .25\nc.tif .6 .8 0 1 .5 .25\n",
    "colours, no endings": "a .5 .3 .8 1 .5 .25\nb 0 0 1 1 .5 .25\nc .6 .8 0 1 .5 .25\n",
    "quotes": '"a.tif" .5 .3 .8\n"b.tif" 0 0 1\n"c.tif" .6 .8 0\n',
}


def written(folder: Path, text: str, name: str = "dome.lp", encoding: str = "utf-8") -> Path:
    (folder / name).write_bytes(text.encode(encoding))
    return folder / name


@pytest.mark.parametrize("text", READ.values(), ids=READ)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-crlf"])
def test_lists_of_lights_are_read(tmp_path: Path, text: str, encoding: str) -> None:
    if encoding.endswith("crlf"):
        text, encoding = text.replace("\n", "\r\n"), "utf-16"
    path = written(tmp_path, text, encoding=encoding)
    np.testing.assert_array_equal(rfpipe.read_lights(path, PICTURES), np.float32([A, B, C]))


@pytest.mark.parametrize(
    ("names", "pictures", "expected"),
    [
        # numbers, in the file's order; as text, img_10 is before img_2
        (["x1.jpg", "x2.jpg", "x10.jpg"], ["x1.tif", "x2.tif", "x10.tif"], [0, 1, 2]),
        (["x1.jpg", "x10.jpg", "x2.jpg"], ["x1.tif", "x2.tif", "x10.tif"], [0, 2, 1]),
        (["Light_01", "Light_03", "Light_02"], ["DSC1.nef", "DSC2.nef", "DSC3.nef"], [0, 2, 1]),
        (["2023_7.jpg", "2023_9.jpg"], ["take2_009.tif", "take2_007.tif"], [1, 0]),
        (["cat.1", "cat.0", "cat.2"], ["cat.0.png", "cat.1.png", "cat.2.png"], [1, 0, 2]),
        (["img 1", "img 2"], ["img 2.png", "img 1.png"], [1, 0]),
        (["lamp_1.tif", "lmap_2.tif"], ["lamp_2.tif", "lamp_1.tif"], [1, 0]),
        # Unicode: composed in the list, decomposed in the folder, and the other way round
        ([COMPOSED, "rot.jpg"], [DECOMPOSED, "rot.tif"], [0, 1]),
        ([DECOMPOSED, "rot.jpg"], ["rot.tif", COMPOSED.upper()], [1, 0]),
    ],
)  # fmt: skip
def test_lines_are_assigned_to_the_named_pictures(tmp_path, names, pictures, expected) -> None:
    lights = np.random.default_rng(0).normal(size=(len(names), 3)).astype(np.float32)
    rows = zip(names, lights, strict=True)
    text = "".join(f"{name} {x:.9g} {y:.9g} {z:.9g}\n" for name, (x, y, z) in rows)
    path = written(tmp_path, f"{len(names)}\n{text}")
    assert light_names_in(tmp_path, pictures) == tuple(names)
    np.testing.assert_array_equal(rfpipe.read_lights(path, pictures), lights[expected])


REFUSED = {
    "other names": ("x.jpg 0 0 1\ny.jpg 0 1 1\nz.jpg 1 0 1", r"picture a\.tif.*line x\.jpg"),
    "one misspelt": ("a.jpg 0 0 1\nbb.jpg 0 1 1\nc.jpg 1 0 1", r"picture b\.tif.*line bb\.jpg"),
    "one missing": ("a.jpg 0 0 1\nc.jpg 1 0 1", r"no line for the picture b\.tif.*2 lines.*3"),
    "twice": ("a.jpg 0 0 1\nA.tif 0 1 1\nb.jpg 1 0 1\nc.jpg 1 1 1", r"lines a\.jpg and A\.tif"),
    "twice alike": ("a.jpg 0 0 1\na.jpg 0 1 1\nb.jpg 1 0 1", r"lines a\.jpg and a\.jpg"),
    "some names": ("a.jpg 0 0 1\n0 1 1\nc.jpg 1 0 1", "line 2 has no name"),
    "count": ("4\na.jpg 0 0 1\nb.jpg 0 1 1\nc.jpg 1 0 1", "counts 4 lights, it has 3"),
    "number of lights": ("0 0 1\n0 1 1", "2 directions of lights for 3 pictures"),
    "two numbers": ("a.jpg 0 0 1\nb.jpg 0 1\nc.jpg 1 0 1", r"line 2 is 'b\.jpg 0 1'"),
    "a word": ("a.jpg 0 0 1\nb.jpg 0 one 1\nc.jpg 1 0 1", "line 2 is"),
    "NaN": ("a.jpg 0 0 1\nb.jpg 0 nan 1\nc.jpg 1 0 1", "has no direction"),
    "no direction": ("a.jpg 0 0 1\nb.jpg 0 0 0\nc.jpg 1 0 1", "has no direction"),
    "header": ("name x y z\na.jpg 0 0 1", "line 1 is 'name x y z'"),
    "which three": ("a 1 2 3 4\nd 1 2 3 4\ne 1 2 3 5", None),
    "which three, no names": ("1 2 3 4\n1 2 3 5\n1 2 4 5", "4 numbers per line.*ambiguous"),
    "commas of two meanings": ("a.tif,0,5,0,3,0,8\nb.tif,0,1,0,2,0,3", "may be decimal"),
    "points and commas": ("a.tif 0,5 0.3 0.8\nb.tif 0 0 1", "may be decimal"),
    "empty": ("# nothing\n\n", "is empty"),
    "UTF-16 without mark": ("a.jpg 0 0 1\n".encode("utf-16-le").decode("latin1"), "zero bytes"),
}


@pytest.mark.parametrize(("text", "message"), REFUSED.values(), ids=REFUSED)
def test_invalid_lists_are_refused(tmp_path: Path, text: str, message: str | None) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError, match=message or "has no line for the picture b") as error:
        rfpipe.read_lights(path, PICTURES)
    assert str(path) in str(error.value)


def test_lists_that_count_from_0_and_1_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "".join(f"light{index} 0 {index} 1\n" for index in range(3)))
    with pytest.raises(InputError, match=r"picture img3\.tif.*its line light0"):
        rfpipe.read_lights(path, [f"img{index}.tif" for index in (3, 1, 2)])
    with pytest.raises(InputError, match=r"pictures a\.tif and a\.jpg have one name"):
        rfpipe.read_lights(path, ["a.tif", "a.jpg"])


def test_directions_are_identified_by_their_length_of_1(tmp_path: Path) -> None:
    lights = np.float32([(0.6, 0, 0.8), (0, -0.6, 0.8), (0, 0, 1)])
    before = "".join(f"{i + 7} {x} {y} {z}\n" for i, (x, y, z) in enumerate(lights))
    after = "".join(f"{x} {y} {z} {i + 7}\n" for i, (x, y, z) in enumerate(lights))
    for text in (before, after):
        result = rfpipe.read_lights(written(tmp_path, text))
        np.testing.assert_allclose(result, lights, rtol=1e-6)
    named = written(tmp_path, "".join(f"img {i} 3 4 5\n" for i in range(3)))
    pictures = [f"img {index}.tif" for index in range(3)]
    assert (rfpipe.read_lights(named, pictures) == (3, 4, 5)).all()


@pytest.mark.parametrize(
    ("name", "below"),
    [
        ("dome.LP", "."), ("dome.lp", "pictures"), ("lights.txt", "."), ("Lights.TXT", ".."),
        ("light_directions.txt", "."), ("dome.lp", ".."),
    ],
)  # fmt: skip
def test_lists_are_found_next_to_or_above_the_pictures(
    tmp_path: Path, name: str, below: str
) -> None:
    folder = tmp_path / "cat"
    (folder / "pictures").mkdir(parents=True)
    assert lights_in(folder, PICTURES, parent=True) is None
    written(folder / below, "3\n.5 .3 .8\n0 0 1\n.6 .8 0\n", name)
    written(folder, "3", "._dome.lp")
    result = lights_in(folder, PICTURES, parent=True)
    np.testing.assert_array_equal(result, np.float32([A, B, C]))
    assert (lights_in(folder, PICTURES) is None) == (below == "..")
    written(folder / below, "3\n1 0 0\n0 1 0\n0 0 1\n", "light_DIRECTIONS.txt")
    written(folder / below, "3\n1 0 0\n0 1 0\n0 0 1\n", "other.lp")
    with pytest.raises(InputError, match=r"several files of lights.*; keep one"):
        lights_in(folder, PICTURES, parent=True)


def test_a_list_of_pictures_orders_lights_without_names(tmp_path: Path) -> None:
    written(tmp_path, ".5 .3 .8\n0 0 1\n.6 .8 0\n", "light_directions.txt")
    written(tmp_path, "b.png\nc.png\na.png\n", "filenames.txt")
    result = lights_in(tmp_path, PICTURES)
    np.testing.assert_array_equal(result, np.float32([C, A, B]))
    written(tmp_path, "b.png\nc.png\n", "filenames.txt")
    with pytest.raises(InputError, match=r"filenames\.txt: lists 2 pictures for 3 lights"):
        lights_in(tmp_path, PICTURES)


@pytest.mark.parametrize("kind", ["complex128", "<U3", "bool"])
def test_arrays_of_other_types_are_rejected(tmp_path: Path, kind: str) -> None:
    np.save(tmp_path / "lights.npy", np.ones((3, 3)).astype(kind))
    with pytest.raises(InputError, match=r"lights\.npy: expected an array"):
        lights_in(tmp_path, PICTURES)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1\n2\n0.5\n", [[1], [2], [0.5]]),
        ("1 2 3\n4 5 6\n7 8 9\n", [[1, 2, 3], [4, 5, 6], [7, 8, 9]]),
        ("1,2,3\n4,5,6\n7,8,9\n", [[1, 2, 3], [4, 5, 6], [7, 8, 9]]),
        ("# R\n1,5\n2,5\n3\n", [[1.5], [2.5], [3]]),
    ],
)
def test_intensities_in_the_order_of_the_lights(tmp_path: Path, text: str, expected) -> None:
    assert intensities_in(tmp_path, PICTURES) is None
    written(tmp_path, text, "light_intensities.txt")
    np.testing.assert_array_equal(intensities_in(tmp_path, PICTURES), np.float32(expected))
    written(tmp_path, "c 0 0 1\na 0 1 1\nb 1 0 1\n")
    result = intensities_in(tmp_path, PICTURES)
    np.testing.assert_array_equal(result, np.float32(expected)[[1, 2, 0]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n2\n", "2 directions of lights for 3|2 lines"),
        ("1\n2\n0\n", "above 0"),
        ("1\n2\n-3\n", "above 0"),
        ("1 2\n2 3\n3 4\n", "1 or 3 per line"),
        ("1\n2 3 4\n3\n", "line 2 is '2 3 4'"),
        ("1\none\n3\n", "line 2 is 'one'"),
    ],
)
@pytest.mark.parametrize("lights", [None, "a 0 0 1\nb 0 1 1\nc 1 0 1\n"])
def test_invalid_intensities_are_refused(tmp_path: Path, text, message, lights) -> None:
    written(tmp_path, text, "light_intensities.txt")
    if lights:
        written(tmp_path, lights)
    with pytest.raises(InputError, match=r"light_intensities\.txt.*(?:" + message + ")"):
        intensities_in(tmp_path, PICTURES)
