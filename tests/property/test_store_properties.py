"""Whatever is written, in whatever order, comes back."""

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of
from numpy.typing import NDArray

from rfpipe.store import FrameStore, open_arrays, write_arrays

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
        while True:
            with FrameStore.create(
                path, shape, dtype, "abc", {}, items_per_chunk=items_per_chunk
            ) as store:
                runs = store.missing(longest=data.draw(st.integers(1, 5)))
                if not runs:
                    break
                for start, stop in data.draw(st.permutations(runs))[: len(runs) // 2 + 1]:
                    store.write(start, frames[start:stop])
        found = FrameStore.open(path).read(0, shape[0])
    assert found.tobytes() == frames.tobytes()  # NaN included


@settings(max_examples=20)
@given(
    st.dictionaries(
        st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_-]{0,8}", fullmatch=True),
        DTYPES.flatmap(
            lambda dtype: arrays_of.arrays(
                dtype, arrays_of.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5)
            )
        ),
        max_size=3,
    )
)
def test_bundles_come_back(arrays: dict[str, NDArray[Any]]) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "s"
        digest = write_arrays(path, arrays, {"names": sorted(arrays)})
        bundle = open_arrays(path)
        assert bundle.digest == digest
        assert bundle.names == tuple(sorted(arrays))
        for name, array in arrays.items():
            found = bundle.read(name)
            assert found.shape == array.shape
            assert found.tobytes() == array.tobytes()
