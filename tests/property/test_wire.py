"""Messages between server and client: exact round trips and detection of damage."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from rfpipe.errors import TransferError
from rfpipe.rigs.messages import decode_patterns, encode_patterns, pack_message, unpack_message

SHAPES = npst.array_shapes(min_dims=3, max_dims=4, min_side=1, max_side=6)
DTYPES = st.sampled_from(
    [np.bool_, np.uint8, np.uint16, np.int32, np.int64, np.float32, np.float64]
)


@st.composite
def patterns(draw: st.DrawFn) -> np.ndarray:
    """Draw patterns of each kind that has a separate encoding."""
    shape = draw(SHAPES)
    if draw(st.booleans()):
        return draw(npst.arrays(np.bool_, shape)).astype(np.float32)
    return draw(npst.arrays(np.float32, shape, elements=st.floats(0, 1, width=32)))


@given(patterns())
def test_patterns_are_decoded_exactly(shown: np.ndarray) -> None:
    keys = [(1, index) for index in range(len(shown))]
    message = encode_patterns(shown, keys)
    sent = decode_patterns(message, shown.shape[1:], len(shown), shown.nbytes)
    result = sent.expanded(0, len(shown))
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result, shown)
    for index in range(len(shown)):
        np.testing.assert_array_equal(sent.expanded(index, index + 1)[0], shown[index])
    assert sent.keys == keys


@given(st.data(), npst.array_shapes(min_dims=0, min_side=0), DTYPES, st.booleans())
def test_arrays_are_decoded_exactly(
    data: st.DataObject, shape: tuple[int, ...], dtype: type, deflate: bool
) -> None:
    array = data.draw(npst.arrays(dtype, shape))
    message = pack_message(
        {"a": 1, "b": [2, None]}, {"one": array, "two": array[..., None]}, deflate=deflate
    )
    facts, arrays = unpack_message(message, 2 * array.nbytes)
    assert facts == {"a": 1, "b": [2, None]}
    assert arrays["one"].dtype == array.dtype
    assert arrays["one"].tobytes() == array.tobytes()
    assert arrays["two"].shape == (*shape, 1)


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_an_error(content: bytes) -> None:
    with pytest.raises(TransferError):
        unpack_message(content, 1000)


@given(st.data())
def test_an_altered_byte_is_detected_or_has_no_effect(data: st.DataObject) -> None:
    array = np.arange(24, dtype=np.uint16).reshape(2, 3, 4)
    message = bytearray(pack_message({"a": 1}, {"one": array}, deflate=data.draw(st.booleans())))
    message[data.draw(st.integers(0, len(message) - 1))] ^= data.draw(st.integers(1, 255))
    try:
        facts, arrays = unpack_message(bytes(message), 1000)
    except TransferError:
        return
    # names have no checksum
    assert facts == {"a": 1}
    np.testing.assert_array_equal(next(iter(arrays.values())), array)


def test_messages_are_numpy_archives_with_reproducible_bytes() -> None:
    arrays = {"one": np.arange(6).reshape(2, 3), "two": np.array(True)}
    message = pack_message({"a": [1]}, arrays)
    assert message == pack_message({"a": [1]}, arrays)
    with np.load(io.BytesIO(message)) as archive:
        for name, array in arrays.items():
            np.testing.assert_array_equal(archive[name], array)
        assert json.loads(archive["facts.json"]) == {"a": [1]}
