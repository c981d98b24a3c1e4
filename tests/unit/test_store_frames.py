"""Frame stores: round trips, journal, damage, locks, stale configurations."""

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from numpy.typing import NDArray

from rfpipe.errors import InputError, IntegrityError, LockedError, StaleStoreError, StoreError
from rfpipe.store import FrameStore, ItemWriter, bytes_on_disk
from rfpipe.units import COUNTS, RADIANCE

SHAPE = (7, 2, 5, 6, 3)


def counts(shape: tuple[int, ...] = SHAPE, seed: int = 0) -> NDArray[np.uint16]:
    return np.random.default_rng(seed).integers(0, 4096, shape).astype(COUNTS)


def filled(
    path: Path, frames: NDArray[Any], items_per_chunk: int = 1, chunks_per_file: int = 1
) -> str:
    with FrameStore.create(
        path,
        frames.shape,
        frames.dtype,
        "abc",
        {"unit": "count"},
        items_per_chunk=items_per_chunk,
        chunks_per_file=chunks_per_file,
    ) as store:
        for start, stop in store.missing(longest=2):
            store.write(start, frames[start:stop])
        return store.digest()


def tree(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


@pytest.mark.parametrize(("items_per_chunk", "chunks_per_file"), [(1, 1), (3, 1), (1, 3)])
@pytest.mark.parametrize("compression", ["zstd", "lz4", None])
@pytest.mark.parametrize("dtype", [COUNTS, RADIANCE])
def test_frames_come_back_as_they_went_in(
    tmp_path: Path, dtype: type, compression: Any, items_per_chunk: int, chunks_per_file: int
) -> None:
    frames: NDArray[Any] = counts().astype(dtype)
    attributes = {"unit": "count", "exposures": (0.5, 1.0)}
    path = tmp_path / "new folder" / "capture.zarr"
    with FrameStore.create(
        path,
        frames.shape,
        dtype,
        "abc",
        attributes,
        items_per_chunk=items_per_chunk,
        chunks_per_file=chunks_per_file,
        compression=compression,
    ) as store:
        store.write(3, frames[3:])
        store.write(0, frames[:3])
    reader = FrameStore.open(path)
    assert reader.complete
    assert reader.done.all()
    assert reader.attributes == {"unit": "count", "exposures": [0.5, 1.0]}
    assert (reader.fingerprint, reader.shape, reader.dtype) == ("abc", SHAPE, np.dtype(dtype))
    assert reader.items_per_chunk == items_per_chunk
    assert reader.items_per_file == items_per_chunk * chunks_per_file
    assert bytes_on_disk(path) == sum(map(len, tree(path).values()))
    for start, stop in ((0, 7), (1, 4), (5, 5), (6, 7)):
        np.testing.assert_array_equal(reader.read(start, stop), frames[start:stop])
    # any zarr reader opens it
    np.testing.assert_array_equal(zarr.open_array(path, mode="r")[...], frames)


@pytest.mark.parametrize(("items_per_chunk", "chunks_per_file"), [(1, 1), (3, 1), (1, 7), (2, 2)])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_files_are_those_that_zarr_would_write(
    tmp_path: Path, compression: Any, items_per_chunk: int, chunks_per_file: int
) -> None:
    frames = counts()
    path = tmp_path / "s"
    with FrameStore.create(
        path,
        SHAPE,
        COUNTS,
        "abc",
        {},
        items_per_chunk=items_per_chunk,
        chunks_per_file=chunks_per_file,
        compression=compression,
    ) as store:
        store.write(0, frames)
    ours = tree(path)
    zarr.open_array(path, mode="r+")[...] = frames
    assert tree(path) == ours


def test_items_of_another_writer_count_once_they_are_entered(tmp_path: Path) -> None:
    frames = counts()
    path = tmp_path / "s"
    with FrameStore.create(path, SHAPE, COUNTS, "abc", {}, items_per_chunk=2) as store:
        writer = ItemWriter(path, "abc")
        digests = writer.write_items(2, frames[2:4])
        last = writer.write_items(6, frames[6:])
        assert not store.done.any()
        assert not FrameStore.open(path).done.any()
        store.enter(2, digests)
        store.enter(6, last)
        assert np.flatnonzero(store.done).tolist() == [2, 3, 6]
        np.testing.assert_array_equal(store.read(2, 4), frames[2:4])
        store.write(0, frames[:2])
        store.write(4, frames[4:6])
    assert FrameStore.open(path).digest() == filled(tmp_path / "plain", frames, 2)
    assert tree(path)["journal.jsonl"] == tree(tmp_path / "plain")["journal.jsonl"]


def test_a_shard_is_added_to_chunk_by_chunk_and_there_once_it_is_whole(tmp_path: Path) -> None:
    frames = counts()
    path = tmp_path / "s"
    with FrameStore.create(
        path, SHAPE, COUNTS, "abc", {}, items_per_chunk=2, chunks_per_file=2
    ) as store:
        writer = ItemWriter(path, "abc")
        with writer.adding(4) as add:
            digests = add(frames[4:6])
            assert not list(path.glob("c.*"))
            digests += add(frames[6:])
        store.enter(4, digests)
        with pytest.raises(ValueError, match="1 chunks for 4 items"), writer.adding(0) as add:
            add(frames[:2])
        with pytest.raises(InputError, match="a block of"), writer.adding(0) as add:
            add(frames[:2, :1])
        assert [file.name for file in path.glob("*c.*")] == ["c.1.0.0.0.0"]
        assert store.missing() == [(0, 4)]
        store.write(0, frames[:4])
        np.testing.assert_array_equal(store.read(1, 6), frames[1:6])
    assert FrameStore.open(path).digest() == filled(tmp_path / "plain", frames)


def test_a_writer_of_a_run_that_is_over_leaves_a_new_store_alone(tmp_path: Path) -> None:
    filled(tmp_path / "s", counts())
    with pytest.raises(StaleStoreError, match="fingerprint abc instead of old"):
        ItemWriter(tmp_path / "s", "old")
    with pytest.raises(StoreError, match="no store of frames here"):
        ItemWriter(tmp_path / "t", "old")
    with pytest.raises(StoreError, match="isn't open for writing"):
        FrameStore.open(tmp_path / "s").enter(0, ["0" * 32])


@pytest.mark.parametrize("items_per_chunk", [1, 2])
def test_bytes_and_digest_do_not_depend_on_the_order_of_writing(
    tmp_path: Path, items_per_chunk: int
) -> None:
    frames = counts()
    for name, order in (("forward", (0, 2, 4, 6)), ("shuffled", (4, 0, 6, 2))):
        with FrameStore.create(
            tmp_path / name, SHAPE, COUNTS, "abc", {"b": 1, "a": 2}, items_per_chunk=items_per_chunk
        ) as store:
            for start in order:
                store.write(start, frames[start : start + 2])
    assert tree(tmp_path / "forward") == tree(tmp_path / "shuffled")
    digests = {FrameStore.open(tmp_path / name).digest() for name in ("forward", "shuffled")}
    assert len(digests) == 1


def test_large_frames_compress_to_the_same_bytes_each_time(tmp_path: Path) -> None:
    # blosc with several threads would lay its blocks down as they finish
    frames = counts((1, 700, 900, 3))
    filled(tmp_path / "a", frames)
    filled(tmp_path / "b", frames)
    assert tree(tmp_path / "a") == tree(tmp_path / "b")


def test_black_frames_count_as_captured(tmp_path: Path) -> None:
    black = np.zeros(SHAPE, COUNTS)
    filled(tmp_path / "s", black)
    with FrameStore.create(tmp_path / "s", SHAPE, COUNTS, "abc", {}) as store:
        assert store.missing() == []
    assert len(list((tmp_path / "s").glob("c.*"))) == 7
    np.testing.assert_array_equal(FrameStore.open(tmp_path / "s").read(0, 7), black)


def test_an_empty_store_is_complete_at_once(tmp_path: Path) -> None:
    shape = (0, *SHAPE[1:])
    digest = filled(tmp_path / "s", np.zeros(shape, COUNTS))
    reader = FrameStore.open(tmp_path / "s")
    assert reader.complete
    assert reader.missing() == []
    assert reader.digest() == digest
    assert reader.read(0, 0).shape == shape


def test_missing_runs_are_ordered_and_cut_to_whole_chunks(tmp_path: Path) -> None:
    frames = counts((11, 3))
    with FrameStore.create(
        tmp_path / "s", frames.shape, COUNTS, "abc", {}, items_per_chunk=2
    ) as store:
        assert store.missing() == [(0, 11)]
        assert store.missing(longest=5) == [(0, 4), (4, 8), (8, 11)]
        assert store.missing(longest=1) == [(0, 2), (2, 4), (4, 6), (6, 8), (8, 10), (10, 11)]
        store.write(4, frames[4:6])
        store.write(10, frames[10:])
        assert store.missing() == [(0, 4), (6, 10)]
        np.testing.assert_array_equal(np.flatnonzero(store.done), [4, 5, 10])
        np.testing.assert_array_equal(store.read(4, 6), frames[4:6])


def test_resume_goes_on_where_it_stopped_and_keeps_its_layout(tmp_path: Path) -> None:
    frames = counts()
    filled(tmp_path / "whole", frames, items_per_chunk=2)
    for start in (0, 4):
        with FrameStore.create(
            tmp_path / "s",
            SHAPE,
            COUNTS,
            "abc",
            {"unit": "count" if start == 0 else "other"},
            items_per_chunk=2 if start == 0 else 5,
            chunks_per_file=1 if start == 0 else 3,  # as of a store from before there were shards
        ) as store:
            assert store.missing() == [(start, 7)]
            store.write(start, frames[start : start + 4])
    assert tree(tmp_path / "s") == tree(tmp_path / "whole")


def test_a_reader_sees_what_is_captured_while_another_writes(tmp_path: Path) -> None:
    frames = counts()
    with FrameStore.create(tmp_path / "s", SHAPE, COUNTS, "abc", {}) as store:
        store.write(0, frames[:3])
        reader = FrameStore.open(tmp_path / "s")
        np.testing.assert_array_equal(reader.read(0, 3), frames[:3])
        assert not reader.complete
        with pytest.raises(StoreError, match=r"item 3 isn't captured yet \(3 of 7 are\)"):
            reader.read(2, 5)
        with pytest.raises(StoreError, match="3 of 7 items captured"):
            reader.digest()
        with pytest.raises(StoreError, match="isn't open for writing"):
            reader.write(3, frames[3:4])


def flip_a_bit(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 4
    file.write_bytes(content)


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-7])


def empty(file: Path) -> None:
    file.write_bytes(b"")


def remove(file: Path) -> None:
    file.unlink()


def swap(file: Path) -> None:
    file.write_bytes((file.parent / "c.0.0.0.0.0").read_bytes())


@pytest.mark.parametrize("damage", [flip_a_bit, truncate, empty, remove, swap])
@pytest.mark.parametrize(("items_per_chunk", "chunks_per_file"), [(1, 1), (2, 1), (1, 2)])
def test_damage_is_named_and_healed_by_the_next_writer(
    tmp_path: Path,
    damage: Any,
    items_per_chunk: int,
    chunks_per_file: int,
    caplog: pytest.LogCaptureFixture,
) -> None:
    frames = counts()
    path = tmp_path / "s"
    digest = filled(path, frames, items_per_chunk, chunks_per_file)
    intact = tree(path)
    in_a_file = items_per_chunk * chunks_per_file
    first = 4 if in_a_file == 2 else 5
    chunk = path / f"c.{5 // in_a_file}.0.0.0.0"
    damage(chunk)
    reader = FrameStore.open(path)
    np.testing.assert_array_equal(reader.read(0, first), frames[:first])
    with pytest.raises(IntegrityError, match="Run the stage that writes") as caught:
        reader.read(1, 7)
    assert str(chunk) in str(caught.value)
    with (
        caplog.at_level(logging.WARNING),
        FrameStore.create(path, SHAPE, COUNTS, "abc", {}) as store,
    ):
        assert store.missing() == [(first, 6)]
        store.write(first, frames[first:6])
        assert store.digest() == digest
    assert "are damaged and will be written again" in caplog.text
    assert tree(path) == intact


@pytest.mark.parametrize("cut", [1, 20, 90])
@pytest.mark.parametrize("items_per_chunk", [1, 2])
def test_a_torn_journal_line_does_not_count(tmp_path: Path, cut: int, items_per_chunk: int) -> None:
    frames = counts((8, 5))
    path = tmp_path / "s"
    filled(path, frames, items_per_chunk)
    intact = tree(path)
    journal = path / "journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-cut])
    lost = {1: 1, 20: 1, 90: 2}[cut]
    first = (8 - lost) // items_per_chunk * items_per_chunk
    np.testing.assert_array_equal(np.flatnonzero(~FrameStore.open(path).done), range(first, 8))
    with FrameStore.create(path, frames.shape, COUNTS, "abc", {}) as store:
        assert store.missing() == [(first, 8)]
        store.write(first, frames[first:])
    assert tree(path) == intact


@pytest.mark.parametrize(
    "line",
    [
        b"not json",
        b"[3]",
        b'{"item":3}',
        b'{"item":"3","digest":"00","check":"00000000"}',
        b'{"item":3,"digest":"00000000000000000000000000000000","check":"00000000"}',
        b"\x00" * 60,
    ],
)
def test_an_altered_journal_line_does_not_count(tmp_path: Path, line: bytes) -> None:
    frames = counts((6, 5))
    path = tmp_path / "s"
    filled(path, frames)
    intact = tree(path)
    journal = path / "journal.jsonl"
    lines = journal.read_bytes().splitlines()
    lines[3] = line
    journal.write_bytes(b"\n".join(lines) + b"\n")
    with FrameStore.create(path, frames.shape, COUNTS, "abc", {}) as store:
        assert store.missing() == [(3, 4)]
        store.write(3, frames[3:4])
    assert tree(path) == intact


def test_leftovers_of_a_kill_are_cleared(tmp_path: Path) -> None:
    path = tmp_path / "s"
    (tmp_path / ".s.new").mkdir()
    (tmp_path / ".s.new" / "zarr.json").write_text("half")
    filled(path, counts())
    intact = tree(path)
    (path / "c.6.0.0.0.1234.partial").write_bytes(b"half a chunk")
    (path / ".journal.jsonl.partial").write_bytes(b"half a journal")
    with FrameStore.create(path, SHAPE, COUNTS, "abc", {}) as store:
        assert store.complete
    assert tree(path) == intact
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_a_second_writer_is_kept_out(tmp_path: Path) -> None:
    frames = counts()
    with FrameStore.create(tmp_path / "s", SHAPE, COUNTS, "abc", {}) as store:
        store.write(0, frames[:2])
        with pytest.raises(LockedError, match=r"process \d+ is writing this store"):
            FrameStore.create(tmp_path / "s", SHAPE, COUNTS, "abc", {})
        with pytest.raises(LockedError, match="wait until it ends"):
            FrameStore.discard(tmp_path / "s")
        store.write(2, frames[2:])
        assert store.complete
    store.close()  # a second time does nothing
    with pytest.raises(StoreError, match="isn't open for writing"):
        store.write(0, frames[:1])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"fingerprint": "other"}, "fingerprint abc instead of other"),
        ({"shape": (8, *SHAPE[1:])}, r"shape \(7, 2, 5, 6, 3\) instead of \(8,"),
        ({"dtype": RADIANCE}, "dtype uint16 instead of float32"),
    ],
)
def test_a_stale_store_is_refused_until_discarded(
    tmp_path: Path, change: dict[str, Any], named: str
) -> None:
    filled(tmp_path / "s", counts())
    intact = tree(tmp_path / "s")
    wanted: dict[str, Any] = {"shape": SHAPE, "dtype": COUNTS, "fingerprint": "abc", **change}
    with pytest.raises(StaleStoreError, match=named):
        FrameStore.create(tmp_path / "s", attributes={}, **wanted)
    assert tree(tmp_path / "s") == intact
    FrameStore.discard(tmp_path / "s")
    FrameStore.discard(tmp_path / "s")  # nothing there is fine
    assert list(tmp_path.iterdir()) == []
    with FrameStore.create(tmp_path / "s", attributes={}, **wanted) as store:
        assert not store.done.any()


@pytest.mark.parametrize(
    ("start", "block", "named"),
    [
        (0, np.zeros((2, 4), np.float32), "a block of float32"),
        (0, np.zeros((2, 5), COUNTS), r"expected uint16 \(items, 4\)"),
        (6, np.zeros((4, 4), COUNTS), "items 6 to 10 asked for"),
        (-2, np.zeros((2, 4), COUNTS), "items -2 to 0 asked for"),
        (1, np.zeros((2, 4), COUNTS), "aren't whole files of 2"),
        (0, np.zeros((1, 4), COUNTS), "aren't whole files of 2"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(
    tmp_path: Path, start: int, block: NDArray[Any], named: str
) -> None:
    with FrameStore.create(tmp_path / "s", (7, 4), COUNTS, "abc", {}, items_per_chunk=2) as store:
        with pytest.raises(InputError, match=named):
            store.write(start, block)
        assert not store.done.any()


def test_threads_share_a_store(tmp_path: Path) -> None:
    frames = counts((60, 8, 8))
    with (
        FrameStore.create(tmp_path / "s", frames.shape, COUNTS, "abc", {}) as store,
        ThreadPoolExecutor(4) as pool,
    ):
        list(pool.map(lambda start: store.write(start, frames[start : start + 5]), range(0, 60, 5)))
    reader = FrameStore.open(tmp_path / "s")
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda start: reader.read(start, start + 10), range(0, 60, 10)))
    np.testing.assert_array_equal(np.concatenate(found), frames)


def test_captured_items_are_not_overwritten(tmp_path: Path) -> None:
    frames = counts()
    with FrameStore.create(tmp_path / "s", SHAPE, COUNTS, "abc", {}) as store:
        store.write(2, frames[2:4])
        store.write(0, frames[:0])  # nothing to write is fine
        with pytest.raises(StoreError, match="item 2 is captured already"):
            store.write(0, frames[4:7])
        np.testing.assert_array_equal(store.read(2, 4), frames[2:4])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"shape": (4,)}, "at least one element an item"),
        ({"shape": (4, 0)}, "at least one element an item"),
        ({"shape": (-1, 3)}, r"shape \(-1, 3\)"),
        ({"items_per_chunk": 0}, "chunks of 0"),
        ({"dtype": object}, "object in chunks"),
        ({"attributes": {"gain": float("nan")}}, "pass plain data with finite numbers"),
        ({"attributes": {"shape": np.zeros(2)}}, "pass plain data"),
    ],
)
def test_impossible_stores_are_refused(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    wanted: dict[str, Any] = {
        "shape": (4, 3),
        "dtype": COUNTS,
        "fingerprint": "abc",
        "attributes": {},
        **change,
    }
    with pytest.raises(InputError, match=named):
        FrameStore.create(tmp_path / "s", **wanted)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_store_is_named_and_left_alone(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"absent: no store of frames here; run the stage"):
        FrameStore.open(tmp_path / "absent")
    zarr.create_array(tmp_path / "foreign", shape=(2, 2), dtype="u2", attributes={"kind": "x"})
    with pytest.raises(StoreError, match="a store of 'x'; expected one of 'frames'"):
        FrameStore.open(tmp_path / "foreign")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.jpg").write_bytes(b"jpg")
    with pytest.raises(InputError, match="stands here but is no store"):
        FrameStore.create(tmp_path / "photos", SHAPE, COUNTS, "abc", {})
    assert (tmp_path / "photos" / "holiday.jpg").exists()
    (tmp_path / "empty folder").mkdir()
    filled(tmp_path / "empty folder", counts())


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"attributes": {"kind": "frames"}}'])
def test_damaged_metadata_are_named(tmp_path: Path, content: bytes) -> None:
    filled(tmp_path / "s", counts())
    (tmp_path / "s" / "zarr.json").write_bytes(content)
    with pytest.raises(IntegrityError, match=r"zarr\.json: damaged metadata"):
        FrameStore.open(tmp_path / "s")
    with pytest.raises(IntegrityError, match=r"zarr\.json: damaged metadata"):
        FrameStore.create(tmp_path / "s", SHAPE, COUNTS, "abc", {})
    FrameStore.discard(tmp_path / "s")  # and not locked
