"""Patterns of structured light, selected by name."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.fitting.codes import code_patterns
from rfpipe.gray_code import gray_bits, gray_code, gray_number

# Patterns of GrayCodePattern in OpenCV 5.0.0 (contrib) for a width of 5 and a height of 3: every
# second picture, beginning with the first. The pictures between them are their complements.
COLUMNS = [[0, 0, 0, 0, 1], [0, 0, 1, 1, 1], [0, 1, 1, 0, 0]]
ROWS = [[0, 0, 1], [0, 1, 1]]


def opencv(shape: tuple[int, int]) -> np.ndarray:
    """Return pictures in OpenCV's order: recorded ones for 3 x 5 pixels, otherwise by its loop.

    `GrayCodePattern::generate` sets a bit where two neighbouring digits of the pixel's number
    differ, from the last picture to the first, and the complement after it.
    """
    if shape == (3, 5):
        lines = [np.tile(line, (3, 1)) for line in COLUMNS]
        lines += [np.tile(line, (5, 1)).T for line in ROWS]
        return np.stack([row for line in lines for row in (line, 1 - np.array(line))])
    pictures = []
    for axis in (1, 0):
        count = int(np.ceil(np.log2(shape[axis])))
        codes = np.zeros((2 * count, shape[axis]), int)
        for pixel in range(shape[axis]):
            number, before = pixel, pixel % 2
            for picture in range(count):
                number //= 2
                digit = number % 2
                codes[2 * count - 2 * picture - 2, pixel] = digit != before
                codes[2 * count - 2 * picture - 1, pixel] = digit == before
                before = digit
        pictures += [np.broadcast_to(np.expand_dims(code, 1 - axis), shape) for code in codes]
    return np.stack(pictures)


def array(name: str, pictures: int, means: np.ndarray | None = None) -> np.ndarray:
    patterns = code_patterns(name, pictures, means)
    assert len(patterns) == pictures
    stack = np.stack([read() for read in patterns.readers])
    assert stack.dtype == np.float32
    assert stack.shape[1:] == patterns.shape
    return stack


def light(places: list[str], selection: slice = slice(None)) -> np.ndarray:
    """Return the mean light of a 5 x 3 Gray code in an order of its numbers, W and B.

    The camera sees some columns of the projector.
    """
    code = opencv((3, 5))[:, :, selection].mean(axis=(1, 2))
    white_black = {"W": 1.0, "B": 0.0}
    values = [white_black[at] if at in white_black else code[int(at)] for at in places]
    return 0.1 + 0.5 * np.array(values)


TEN = [str(index) for index in range(10)]


@pytest.mark.parametrize("shape", [(3, 5), (1, 9), (64, 64), (54, 96), (108, 192)])
def test_gray_code_equals_opencv_s(shape: tuple[int, int]) -> None:
    expected = opencv(shape)
    name = f"gray:{shape[1]}x{shape[0]}"
    np.testing.assert_array_equal(array(name, len(expected)), expected)
    np.testing.assert_array_equal(array(f"{name},plain", len(expected) // 2), expected[::2])


@pytest.mark.parametrize("count", [1, 2, 3, 100, 128, 1920])
def test_gray_numbers_invert_the_code(count: int) -> None:
    code = gray_code(np.arange(count), gray_bits(count))
    assert len(code) == np.ceil(np.log2(count))
    np.testing.assert_array_equal(gray_number(code), np.arange(count))
    assert (np.diff(code.astype(int), axis=1) != 0).sum(axis=0).tolist() == [1] * (count - 1)


@pytest.mark.parametrize(
    "order",
    [
        [*TEN, "W", "B"],
        [*TEN, "B", "W"],
        ["W", "B", *TEN],
        ["B", "W", *TEN],
        ["W", *TEN, "B"],
        ["B", *TEN, "W"],
        [*TEN[:6], "W", "B", *TEN[6:]],
        [*TEN, "W"],
        [*TEN, "B"],
        ["B", *TEN],
        [*TEN[:6], "W", *TEN[6:]],
        [*TEN[::2], "W", "B"],
        ["W", *TEN[::2]],
    ],
)
@pytest.mark.parametrize("selection", [slice(None), slice(0, 4)], ids=["all", "dark half"])
def test_white_and_black_are_identified_by_their_light(order: list[str], selection: slice) -> None:
    code = opencv((3, 5))
    shown = {"W": np.ones((3, 5)), "B": np.zeros((3, 5))}
    expected = np.stack([shown[at] if at in shown else code[int(at)] for at in order])
    given = array("gray:5x3", len(order), light(order, selection))
    np.testing.assert_array_equal(given, expected)
    stated = "".join(
        f",{name}={order.index(at) + 1}"
        for name, at in (("white", "W"), ("black", "B"))
        if at in order
    )
    np.testing.assert_array_equal(array(f"gray:5x3{stated}", len(order)), expected)


def test_sinusoids_shift_step_by_step() -> None:
    given = array("phase:8x4,period=4+16,steps=3,white=first", 13)
    assert (given[0] == 1).all()
    x, y = np.arange(8), np.arange(4)
    for axis, at in ((x, 1), (y, 7)):
        for period, first in ((4, at), (16, at + 3)):
            for step in range(3):
                line = (1 + np.cos(2 * np.pi * (axis / period - step / 3))) / 2
                shown = given[first + step] if axis is x else given[first + step].T
                np.testing.assert_allclose(shown, np.tile(line, (len(shown), 1)), atol=1e-6)
    np.testing.assert_array_equal(array("phase:8x4,period=4,axis=rows", 4), array(
        "phase:8x4,period=4,steps=4", 8)[4:])  # fmt: skip


def test_patterns_of_a_large_projector_take_no_memory() -> None:
    patterns = code_patterns("gray:1920x1080,white=last,black=first", 46)
    assert patterns.shape == (1080, 1920)
    assert all(0 in read().strides for read in patterns.readers)
    assert (patterns.readers[45]() == 1).all()
    assert (patterns.readers[0]() == 0).all()


@pytest.mark.parametrize(
    ("name", "pictures", "message"),
    [
        ("grey:5x3", 10, "isn't kind:WIDTHxHEIGHT"),
        ("gray:5", 10, "isn't kind:WIDTHxHEIGHT"),
        ("gray:0x3", 10, "isn't kind:WIDTHxHEIGHT"),
        ("gray:5x3,", 10, "isn't kind:WIDTHxHEIGHT"),
        ("gray:5x3,inverse", 10, "gray has no option 'inverse'"),
        ("gray:5x3,period=3", 10, "gray has no option 'period'"),
        ("gray:5x3,axis=x", 10, "axis=x is none of both, columns, rows"),
        ("gray:5x3,plain,complements", 10, "states complements twice"),
        ("gray:5x3,white=12", 11, "'12' isn't one of its 11 pictures"),
        ("gray:5x3,white=0", 11, "'0' isn't one"),
        ("gray:5x3,white=last,black=11", 12, None),
        ("gray:5x3,white=last,black=12", 12, "picture 12 can't be white and black"),
        ("gray:5x3", 9, "no layout has 9 pictures. Possible are 10 pictures: 10 of the code w"),
        ("gray:5x3", 9, "11 pictures: .* and a white or black one; 12 .*, white and black; 5 pict"),
        ("gray:5x3", 12, "2 of the 12 pictures are white or black. State which"),
        ("gray:2x2", 4, "several layouts have 4 pictures"),
        ("gray:5x3,plain", 10, "no layout has 10 pictures"),
        ("gray:5x3,white=none,black=none", 11, "no layout has 11"),
        ("phase:5x3", 10, "lacks period="),
        ("phase:5x3,period=x", 10, r"period=x isn't a number of pixels above 1"),
        ("phase:5x3,period=3,steps=2", 10, "steps=2 isn't a whole number from 3"),
        ("phase:5x3,period=3,plain", 10, "phase has no option 'complements'"),
    ],
)  # fmt: skip
def test_messages_about_mistakes_explain_the_syntax(
    name: str, pictures: int, message: str | None
) -> None:
    if message is None:
        assert len(code_patterns(name, pictures)) == pictures
        return
    with pytest.raises(InputError, match=message) as caught:
        code_patterns(name, pictures)
    assert name in str(caught.value)
    assert "white" in str(caught.value)


@pytest.mark.parametrize(
    ("means", "message"),
    [
        (light([*TEN[:3], "W", *TEN[3:], "B"]), "brightest picture is number 4 and the darkest"),
        (np.ones(12), "the same mean light"),
        (np.ones(11), "expected one for each picture"),
    ],
)
def test_white_at_an_unusual_position_must_be_stated(means: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        code_patterns("gray:5x3", 12, means)


@pytest.mark.parametrize(("place", "end"), [(0, 10), (0, 11), (6, 10)])
def test_a_picture_exchanged_with_white_or_black_is_named(place: int, end: int) -> None:
    order = [*TEN, "W", "B"]
    order[place], order[end] = order[end], order[place]
    means = light(order)
    with pytest.raises(InputError, match=f"{place + 1}"):
        code_patterns("gray:5x3", 12, means)


def test_a_missing_white_is_not_identified() -> None:
    order = [*TEN, "B"]
    black = array("gray:5x3,white=none", 11, light(order))[10]
    assert not black.any()
    with pytest.raises(InputError, match="brightest"):
        code_patterns("gray:5x3,black=none", 11, light(order))
