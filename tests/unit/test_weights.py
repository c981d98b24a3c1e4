"""Integers of pictures, 0 to 255, are rejected as weights of patterns everywhere."""

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import InputError
from rfpipe.patterns import Schedule
from rfpipe.rigs.devices import check_picture
from rfpipe.transport.dense import DenseTransport
from rfpipe.weights import as_weights, picture_weights

SHAPE = (4, 6)
PICTURE = np.arange(24, dtype=np.uint8).reshape(SHAPE) * 11
MATRIX = np.random.default_rng(2).random((1, 24, 24), dtype=np.float32)
TRANSPORT = DenseTransport(SHAPE, SHAPE, 1, [], {"matrix": MATRIX})
RIG = rfpipe.OperatorRig(MATRIX, SHAPE, SHAPE)

ENTRIES = {
    "relight": TRANSPORT.relight,
    "relight_batch": lambda pattern: TRANSPORT.relight_batch(pattern[None]),
    "dual relight": TRANSPORT.T.relight,
    "product": lambda pattern: TRANSPORT @ pattern.ravel(),
    "product from the right": lambda pattern: pattern.ravel() @ TRANSPORT,
    "scipy": lambda pattern: TRANSPORT.channel(0) @ pattern.ravel(),
    "coarser": rfpipe.coarser(TRANSPORT, 1).relight,
    "capture": lambda pattern: RIG.capture(pattern[None], [(0, 0)]),
    "schedule": lambda pattern: Schedule(0, SHAPE, 1, weights=pattern[None]).batch(0, 1),
    "projector": lambda pattern: check_picture(pattern, SHAPE),
}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.int64])
@pytest.mark.parametrize("entry", ENTRIES)
def test_pictures_are_rejected_as_weights(entry: str, dtype: type) -> None:
    with pytest.raises(InputError, match=r"from 0 to 253.*rfpipe\.picture_weights\(picture\)"):
        ENTRIES[entry](PICTURE.astype(dtype))


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.int64, np.float16, np.float64])
@pytest.mark.parametrize("entry", ENTRIES)
def test_masks_and_fractions_are_accepted(entry: str, dtype: type) -> None:
    mask = (PICTURE > 100).astype(np.float32)
    np.testing.assert_allclose(ENTRIES[entry](mask.astype(dtype)), ENTRIES[entry](mask), rtol=1e-6)


@pytest.mark.parametrize("weights", [np.ones(3, complex), np.array(["a"]), np.array([None])])
def test_values_that_are_not_numbers_are_rejected(weights) -> None:
    with pytest.raises(InputError, match="expected weights, real numbers"):
        as_weights(weights)


@pytest.mark.parametrize(("dtype", "white"), [(np.uint8, 255), (np.uint16, 65535), (float, 1)])
def test_white_of_a_picture_is_its_largest_number(dtype: type, white: int) -> None:
    weights = picture_weights(np.array([0, white], dtype))
    assert weights.dtype == np.float32
    assert weights.tolist() == [0, 1]


def test_pictures_for_screens_are_coded() -> None:
    np.testing.assert_allclose(
        picture_weights(np.array([0, 5, 128, 255], np.uint8), "srgb"),
        [0, 5 / 255 / 12.92, 0.21586, 1],
        rtol=1e-4,
    )


@pytest.mark.parametrize(
    "picture",
    [np.array([0, 255]), np.array([0, 2.0]), np.array([-0.1]), np.array([np.nan]), np.array(["x"])],
)
def test_pictures_without_a_known_white_are_rejected(picture) -> None:
    with pytest.raises(InputError, match="a picture of"):
        picture_weights(picture)
