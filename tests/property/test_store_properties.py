"""Frames are read as written, in any order of writing."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from rfpipe.store import PictureStore

DTYPES = st.sampled_from([np.uint16, np.float32, np.int64])


@settings(max_examples=20)
@given(data=st.data(), dtype=DTYPES, items_per_chunk=st.integers(1, 4))
def test_frames_written_in_any_order_and_any_sessions(
    data: st.DataObject, dtype: type, items_per_chunk: int
) -> None:
    shape = data.draw(st.tuples(st.integers(0, 9), st.integers(1, 4), st.integers(1, 3)))
    frames = data.draw(arrays_of.arrays(dtype, shape))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        is_complete = False
        while not is_complete:
            with PictureStore.create(
                path, shape, dtype, "abc", {}, items_per_chunk=items_per_chunk
            ) as store:
                runs = store.missing(longest=data.draw(st.integers(1, 5)))
                is_complete = not runs
                for start, stop in data.draw(st.permutations(runs))[: len(runs) // 2 + 1]:
                    store.write(start, frames[start:stop])
        result = PictureStore.open(path).read(0, shape[0])
    assert result.tobytes() == frames.tobytes()  # NaN included
