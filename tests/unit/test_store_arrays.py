"""Array bundles: complete or absent, verified, and with reproducible bytes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from numpy.typing import NDArray
from tests.rigs.known_matrix import contents

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store import PictureStore, open_arrays, write_arrays

ATTRIBUTES = {"unit": "radiance", "shape": [3, 4], "gain": 0.1}


def example() -> dict[str, NDArray[Any]]:
    generator = np.random.default_rng(3)
    return {
        "L02.row_values": generator.random(300_000).astype(np.float32),
        "L02.offsets": np.arange(0, 700_000, 7, dtype=np.int64),
        "empty": np.zeros(0, np.float32),
        "empty-rows": np.zeros((0, 3), np.int32),
        "no_columns": np.zeros((4, 0)),
        "zeros": np.zeros((50, 70), np.float32),
        "flags": generator.random(9) > 0.5,
        "scalar": np.array(2.5),
        "transposed": np.arange(12.0).reshape(3, 4).T,
        "wide": generator.integers(0, 9, (3, 2**19)).astype(np.int32),
    }


def test_arrays_are_read_as_written(tmp_path: Path) -> None:
    arrays = example()
    path = tmp_path / "new folder" / "transport.zarr"
    digest = write_arrays(path, arrays, ATTRIBUTES)
    bundle = open_arrays(path)
    assert bundle.names == tuple(sorted(arrays))
    assert bundle.attributes == ATTRIBUTES
    assert bundle.digest == digest
    assert bundle.nbytes_stored == sum(map(len, contents(path).values()))
    for name, array in arrays.items():
        assert bundle.shape(name) == array.shape
        assert bundle.dtype(name) == array.dtype
        stored = bundle.read(name)
        assert stored.dtype == array.dtype
        np.testing.assert_array_equal(stored, array)
    # 6 MiB in chunks of 1 MiB are one file; a small array is one chunk
    assert [file.name for file in (path / "wide").glob("c*")] == ["c.0.0"]
    assert zarr.open_array(path / "wide").chunks == (3, 2**17 * 2 // 3)
    assert zarr.open_array(path / "zeros").shards is None
    assert [p.name for p in path.parent.iterdir()] == ["transport.zarr"]


def test_bytes_and_digest_are_reproducible_and_independent_of_order(tmp_path: Path) -> None:
    arrays = example()
    backwards = dict(reversed(arrays.items()))
    first = write_arrays(tmp_path / "a", arrays, ATTRIBUTES)
    second = write_arrays(tmp_path / "b", backwards, dict(reversed(ATTRIBUTES.items())))
    assert first == second
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_digest_depends_on_names_values_dtypes_shapes_and_attributes(tmp_path: Path) -> None:
    zeros = np.zeros(4, np.int32)
    arrays = [{"b": zeros}, {}]
    arrays += [
        {"a": values} for values in (zeros, zeros + 1, zeros.view("f4"), zeros.reshape(2, 2))
    ]
    digests = [write_arrays(tmp_path / "s", bundle, {}) for bundle in arrays]
    digests += [write_arrays(tmp_path / "s", {"a": zeros}, {"level": 1})]
    assert len(set(digests)) == len(digests)
    assert open_arrays(tmp_path / "s").attributes == {"level": 1}  # replaces the previous bundle


def test_partial_files_of_a_killed_writer_are_removed(tmp_path: Path) -> None:
    write_arrays(tmp_path / "s", {"a": np.arange(3)}, {})
    intact = contents(tmp_path / "s")
    for leftover in (".s.new", ".s.removed"):
        (tmp_path / leftover / "a").mkdir(parents=True)
        (tmp_path / leftover / "a" / "zarr.json").write_text("half")
    write_arrays(tmp_path / "s", {"a": np.arange(3)}, {})
    assert contents(tmp_path / "s") == intact
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


@pytest.mark.parametrize("change", [lambda content: content[:-3], lambda content: b"", None])
@pytest.mark.parametrize("file", ["wide/c.0.0", "wide/zarr.json"])
def test_damage_is_named(tmp_path: Path, file: str, change: Any) -> None:
    arrays = example()
    write_arrays(tmp_path / "s", arrays, ATTRIBUTES)
    damaged = tmp_path / "s" / file
    if change is None:
        damaged.unlink()
    else:
        damaged.write_bytes(change(damaged.read_bytes()))
    bundle = open_arrays(tmp_path / "s")
    np.testing.assert_array_equal(bundle.read("flags"), arrays["flags"])
    with pytest.raises(IntegrityError, match="array 'wide' is missing, truncated or altered"):
        bundle.read("wide")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ('"radiance"', '"count"', "don't match their digest"),
        ("{", "", "damaged metadata"),
    ],
)
def test_altered_attributes_are_found(tmp_path: Path, old: str, new: str, named: str) -> None:
    write_arrays(tmp_path / "s", {"a": np.arange(5)}, ATTRIBUTES)
    metadata = tmp_path / "s" / "zarr.json"
    metadata.write_text(metadata.read_text().replace(old, new))
    with pytest.raises(IntegrityError, match=named):
        open_arrays(tmp_path / "s")
    write_arrays(tmp_path / "s", {"a": np.arange(5)}, ATTRIBUTES)  # may be replaced
    assert open_arrays(tmp_path / "s").names == ("a",)


@pytest.mark.parametrize("name", ["", "../a", ".hidden", "zarr.json"])
def test_names_that_could_leave_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="a name of letters"):
        write_arrays(tmp_path / "s", {name: np.arange(5)}, {})


def test_other_bad_input_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"array 'a' of <U1 can't be stored .* expected booleans"):
        write_arrays(tmp_path / "s", {"a": np.array(["x"])}, {})
    with pytest.raises(InputError, match="pass plain data with finite numbers"):
        write_arrays(tmp_path / "s", {"a": np.arange(5)}, {"gain": float("inf")})
    with pytest.raises(StoreError, match="there is no store of arrays"):
        open_arrays(tmp_path / "s")
    write_arrays(tmp_path / "s", {"a": np.arange(5)}, {})
    for wrong in (open_arrays(tmp_path / "s").read, open_arrays(tmp_path / "s").shape):
        with pytest.raises(InputError, match=r"no array of this name: 'b' .* expected one of a"):
            wrong("b")


def test_other_files_are_not_replaced(tmp_path: Path) -> None:
    PictureStore.create(tmp_path / "s", (2, 3), np.uint16, "abc", {}).close()
    (tmp_path / "photos").mkdir()
    for name in ("s", "photos"):
        with pytest.raises(InputError, match="other than a bundle of arrays exists"):
            write_arrays(tmp_path / name, {}, {})
    assert PictureStore.open(tmp_path / "s").shape == (2, 3)
