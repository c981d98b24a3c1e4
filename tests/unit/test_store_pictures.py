"""Frame stores: round trips, journal, damage, locks, stale configurations."""

import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from numpy.typing import NDArray
from tests.rigs.known_matrix import contents

from rfpipe.errors import InputError, IntegrityError, LockedError, StaleStoreError, StoreError
from rfpipe.store import ItemWriter, PictureStore, bytes_on_disk
from rfpipe.units import COUNTS, RADIANCE

SHAPE = (7, 2, 5, 6, 3)
LAYOUTS = pytest.mark.parametrize(
    "layout",
    [{}, {"items_per_chunk": 2}, {"chunks_per_file": 2}],
    ids=["one by one", "chunks", "shards"],
)


def counts(shape: tuple[int, ...] = SHAPE, seed: int = 0) -> NDArray[np.uint16]:
    return np.random.default_rng(seed).integers(0, 4096, shape).astype(COUNTS)


def create(path: Path, shape: tuple[int, ...] = SHAPE, **options: Any) -> PictureStore:
    made = {"dtype": COUNTS, "fingerprint": "abc", "attributes": {}}
    return PictureStore.create(path, shape, **{**made, **options})


def filled(path: Path, frames: NDArray[Any], **options: Any) -> str:
    with create(path, frames.shape, dtype=frames.dtype, **options) as store:
        for start, stop in store.missing(longest=2):
            store.write(start, frames[start:stop])
        return store.digest()


@pytest.mark.parametrize(("items_per_chunk", "chunks_per_file"), [(1, 1), (3, 1), (1, 3)])
@pytest.mark.parametrize("dtype", [COUNTS, RADIANCE])
def test_frames_are_read_as_written(
    tmp_path: Path, dtype: type, items_per_chunk: int, chunks_per_file: int
) -> None:
    frames: NDArray[Any] = counts().astype(dtype)
    path = tmp_path / "new folder" / "capture.zarr"
    with create(
        path,
        dtype=dtype,
        attributes={"unit": "count", "exposures": (0.5, 1.0)},
        items_per_chunk=items_per_chunk,
        chunks_per_file=chunks_per_file,
    ) as store:
        store.write(3, frames[3:])
        store.write(0, frames[:3])
    reader = PictureStore.open(path)
    assert reader.complete
    assert reader.done.all()
    assert reader.attributes == {"unit": "count", "exposures": [0.5, 1.0]}
    assert (reader.fingerprint, reader.shape, reader.dtype) == ("abc", SHAPE, np.dtype(dtype))
    assert reader.items_per_file == items_per_chunk * chunks_per_file
    ours = contents(path)
    assert bytes_on_disk(path) == sum(map(len, ours.values()))
    for start, stop in ((0, 7), (1, 4), (5, 5)):
        np.testing.assert_array_equal(reader.read(start, stop), frames[start:stop])
    # any zarr reader opens it, and zarr writes the same files
    np.testing.assert_array_equal(zarr.open_array(path, mode="r")[...], frames)
    zarr.open_array(path, mode="r+")[...] = frames
    assert contents(path) == ours


def test_items_of_an_item_writer_count_after_they_are_entered(tmp_path: Path) -> None:
    frames, path = counts(), tmp_path / "s"
    with create(path, items_per_chunk=2) as store:
        writer = ItemWriter(path, "abc")
        digests = writer.write_items(2, frames[2:4])
        last = writer.write_items(6, frames[6:])
        assert not PictureStore.open(path).done.any()
        store.enter(2, digests)
        store.enter(6, last)
        assert np.flatnonzero(store.done).tolist() == [2, 3, 6]
        np.testing.assert_array_equal(store.read(2, 4), frames[2:4])
        store.write(0, frames[:2])
        store.write(4, frames[4:6])
    assert PictureStore.open(path).digest() == filled(tmp_path / "plain", frames, items_per_chunk=2)
    assert contents(path)["journal.jsonl"] == contents(tmp_path / "plain")["journal.jsonl"]
    with pytest.raises(StaleStoreError, match="fingerprint is abc instead of old"):
        ItemWriter(path, "old")
    with pytest.raises(StoreError, match="isn't open for writing"):
        PictureStore.open(path).enter(0, ["0" * 32])


def test_a_shard_is_written_by_chunk_and_appears_when_complete(tmp_path: Path) -> None:
    frames, path = counts(), tmp_path / "s"
    with create(path, items_per_chunk=2, chunks_per_file=2) as store:
        writer = ItemWriter(path, "abc")
        with writer.adding(4) as add:
            digests = add(frames[4:6])
            assert not list(path.glob("c.*"))
            digests += add(frames[6:])
        store.enter(4, digests)
        with pytest.raises(InputError, match="block of uint16"), writer.adding(0) as add:
            add(frames[:2, :1])
        assert [file.name for file in path.glob("*c.*")] == ["c.1.0.0.0.0"]
        assert store.missing() == [(0, 4)]
        store.write(0, frames[:4])
        np.testing.assert_array_equal(store.read(1, 6), frames[1:6])
    assert PictureStore.open(path).digest() == filled(tmp_path / "plain", frames)


def test_large_frames_compress_to_reproducible_bytes(tmp_path: Path) -> None:
    # with several threads blosc would order blocks by their completion
    frames = counts((1, 700, 900, 3))
    filled(tmp_path / "a", frames)
    filled(tmp_path / "b", frames)
    assert contents(tmp_path / "a") == contents(tmp_path / "b")


def test_black_frames_and_empty_stores_count_as_captured(tmp_path: Path) -> None:
    for items in (7, 0):
        black, path = np.zeros((items, *SHAPE[1:]), COUNTS), tmp_path / str(items)
        digest = filled(path, black)
        with create(path, black.shape) as store:
            assert store.complete
            assert store.missing() == []
            assert store.digest() == digest
        assert len(list(path.glob("c.*"))) == items
        np.testing.assert_array_equal(PictureStore.open(path).read(0, items), black)


def test_missing_runs_are_ordered_and_cut_to_whole_chunks(tmp_path: Path) -> None:
    frames = counts((11, 3))
    with create(tmp_path / "s", frames.shape, items_per_chunk=2) as store:
        assert store.missing() == [(0, 11)]
        assert store.missing(longest=5) == [(0, 4), (4, 8), (8, 11)]
        assert store.missing(longest=1) == [(0, 2), (2, 4), (4, 6), (6, 8), (8, 10), (10, 11)]
        store.write(4, frames[4:6])
        store.write(10, frames[10:])
        assert store.missing() == [(0, 4), (6, 10)]
        np.testing.assert_array_equal(store.read(4, 6), frames[4:6])


def test_a_resumed_store_continues_and_keeps_its_layout(tmp_path: Path) -> None:
    frames, path = counts(), tmp_path / "s"
    filled(tmp_path / "whole", frames, items_per_chunk=2, attributes={"unit": "count"})
    first = {"items_per_chunk": 2, "attributes": {"unit": "count"}}
    later = {"items_per_chunk": 5, "attributes": {"unit": "other"}, "chunks_per_file": 3}
    for start, options in ((0, first), (4, later)):
        with create(path, **options) as store:
            assert store.missing() == [(start, 7)]
            store.write(start, frames[start : start + 4])
    assert contents(path) == contents(tmp_path / "whole")


def test_a_reader_sees_what_is_captured_while_another_writes(tmp_path: Path) -> None:
    frames = counts()
    with create(tmp_path / "s") as store:
        store.write(0, frames[:3])
        reader = PictureStore.open(tmp_path / "s")
        np.testing.assert_array_equal(reader.read(0, 3), frames[:3])
        assert not reader.complete
        with pytest.raises(StoreError, match="item 3 isn't captured yet; 3 of 7 are"):
            reader.read(2, 5)
        with pytest.raises(StoreError, match="3 of 7 items are captured"):
            reader.digest()
        with pytest.raises(StoreError, match="isn't open for writing"):
            reader.write(3, frames[3:4])


def flipped(content: bytes) -> bytes:
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 4]) + content[middle + 1 :]


@pytest.mark.parametrize("damage", ["flipped", "cut", "empty", "removed", "swapped"])
@LAYOUTS
def test_damage_is_named_and_repaired_by_the_next_writer(
    tmp_path: Path, damage: str, layout: dict[str, int], caplog: pytest.LogCaptureFixture
) -> None:
    frames, path = counts(), tmp_path / "s"
    digest = filled(path, frames, **layout)
    intact = contents(path)
    first, chunk = (4, path / "c.2.0.0.0.0") if layout else (5, path / "c.5.0.0.0.0")
    content = chunk.read_bytes()
    chunk.write_bytes(
        {"flipped": flipped(content), "cut": content[:-7], "swapped": intact["c.0.0.0.0.0"]}.get(
            damage, b""
        )
    )
    if damage == "removed":
        chunk.unlink()
    reader = PictureStore.open(path)
    np.testing.assert_array_equal(reader.read(0, first), frames[:first])
    with pytest.raises(IntegrityError, match="Run the stage that writes") as caught:
        reader.read(1, 7)
    assert str(chunk) in str(caught.value)
    with caplog.at_level(logging.WARNING), create(path) as store:
        assert store.missing() == [(first, 6)]
        store.write(first, frames[first:6])
        assert store.digest() == digest
    assert "are damaged and will be written again" in caplog.text
    assert contents(path) == intact


@pytest.mark.parametrize(("cut", "lost_items"), [(1, 1), (20, 1), (90, 2)])
@pytest.mark.parametrize("items_per_chunk", [1, 2])
def test_a_truncated_journal_line_is_ignored(
    tmp_path: Path, cut: int, lost_items: int, items_per_chunk: int
) -> None:
    frames, path = counts((8, 5)), tmp_path / "s"
    filled(path, frames, items_per_chunk=items_per_chunk)
    intact = contents(path)
    (path / "journal.jsonl").write_bytes(intact["journal.jsonl"][:-cut])
    first = (8 - lost_items) // items_per_chunk * items_per_chunk
    np.testing.assert_array_equal(np.flatnonzero(~PictureStore.open(path).done), range(first, 8))
    with create(path, frames.shape) as store:
        assert store.missing() == [(first, 8)]
        store.write(first, frames[first:])
    assert contents(path) == intact


@pytest.mark.parametrize(
    "line",
    [
        b"[3]",
        b'{"item":"3","digest":"00","check":"00000000"}',
        b'{"item":3,"digest":"00000000000000000000000000000000","check":"00000000"}',
        b"\x00" * 60,
    ],
)
def test_an_altered_journal_line_is_ignored(tmp_path: Path, line: bytes) -> None:
    frames, path = counts((6, 5)), tmp_path / "s"
    filled(path, frames)
    intact = contents(path)
    lines = intact["journal.jsonl"].splitlines()
    lines[3] = line
    (path / "journal.jsonl").write_bytes(b"\n".join(lines) + b"\n")
    with create(path, frames.shape) as store:
        assert store.missing() == [(3, 4)]
        store.write(3, frames[3:4])
    assert contents(path) == intact


def test_partial_files_of_a_killed_writer_are_removed(tmp_path: Path) -> None:
    path = tmp_path / "s"
    (tmp_path / ".s.new").mkdir()
    (tmp_path / ".s.new" / "zarr.json").write_text("half")
    filled(path, counts())
    intact = contents(path)
    (path / ".c.6.0.0.0.1234.partial").write_bytes(b"half a chunk")
    (path / ".partial-journal.jsonl").write_bytes(b"half a journal")
    with create(path) as store:
        assert store.complete
    assert contents(path) == intact
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_a_second_writer_is_refused(tmp_path: Path) -> None:
    frames = counts()
    with create(tmp_path / "s") as store:
        store.write(0, frames[:2])
        with pytest.raises(LockedError, match=r"process \d+ is writing this store"):
            create(tmp_path / "s")
        with pytest.raises(LockedError, match="wait until it ends"):
            PictureStore.discard(tmp_path / "s")
        store.write(2, frames[2:])
        assert store.complete
        with pytest.raises(StoreError, match="item 4 is captured already"):
            store.write(4, frames[:3])
        np.testing.assert_array_equal(store.read(0, 7), frames)
    store.close()  # a second call has no effect
    with pytest.raises(StoreError, match="isn't open for writing"):
        store.write(0, frames[:1])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"fingerprint": "other"}, "abc.* instead of .*other"),
        ({"shape": (8, *SHAPE[1:])}, r"\(7, 2, 5, 6, 3\).* instead of .*\(8,"),
    ],
)
def test_a_stale_store_is_refused_until_discarded(
    tmp_path: Path, change: dict[str, Any], named: str
) -> None:
    filled(tmp_path / "s", counts())
    intact = contents(tmp_path / "s")
    with pytest.raises(StaleStoreError, match=named):
        create(tmp_path / "s", **change)
    assert contents(tmp_path / "s") == intact
    PictureStore.discard(tmp_path / "s")
    PictureStore.discard(tmp_path / "s")  # a missing store can be discarded
    assert list(tmp_path.iterdir()) == []
    with create(tmp_path / "s", **change) as store:
        assert not store.done.any()


@pytest.mark.parametrize(
    ("start", "block", "named"),
    [
        (0, np.zeros((2, 4), np.float32), "block of float32"),
        (6, np.zeros((4, 4), COUNTS), "no such range of items: '6 to 10'"),
        (0, np.zeros((1, 4), COUNTS), "items 0 to 1 don't fill files of 2"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(
    tmp_path: Path, start: int, block: NDArray[Any], named: str
) -> None:
    with create(tmp_path / "s", (7, 4), items_per_chunk=2) as store:
        with pytest.raises(InputError, match=named):
            store.write(start, block)
        assert not store.done.any()


def test_threads_share_a_store(tmp_path: Path) -> None:
    frames = counts((60, 8, 8))
    with create(tmp_path / "s", frames.shape) as store, ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda start: store.write(start, frames[start : start + 5]), range(0, 60, 5)))
    reader = PictureStore.open(tmp_path / "s")
    with ThreadPoolExecutor(4) as pool:
        blocks = list(pool.map(lambda start: reader.read(start, start + 10), range(0, 60, 10)))
    np.testing.assert_array_equal(np.concatenate(blocks), frames)


def test_other_files_are_named_and_not_replaced(tmp_path: Path) -> None:
    for opening in (PictureStore.open, lambda path: ItemWriter(path, "abc")):
        with pytest.raises(StoreError, match="no store of frames") as caught:
            opening(tmp_path / "absent")
        assert caught.value.place == tmp_path / "absent"
        assert caught.value.remedy == "run the stage that writes it"
    zarr.create_array(tmp_path / "foreign", shape=(2, 2), dtype="u2", attributes={"kind": "x"})
    with pytest.raises(StoreError, match="store of another kind than 'frames': 'x'"):
        PictureStore.open(tmp_path / "foreign")
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.jpg").write_bytes(b"jpg")
    with pytest.raises(InputError, match="other than a store exists here"):
        create(tmp_path / "photos")
    assert (tmp_path / "photos" / "holiday.jpg").exists()
    (tmp_path / "empty folder").mkdir()
    filled(tmp_path / "empty folder", counts())


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'{"attributes": {"kind": "frames"}}'])
def test_damaged_metadata_are_named(tmp_path: Path, content: bytes) -> None:
    filled(tmp_path / "s", counts())
    (tmp_path / "s" / "zarr.json").write_bytes(content)
    for opening in (PictureStore.open, create):
        with pytest.raises(IntegrityError, match="damaged metadata") as caught:
            opening(tmp_path / "s")
        assert caught.value.place == tmp_path / "s" / "zarr.json"
    PictureStore.discard(tmp_path / "s")  # and the store is not locked
