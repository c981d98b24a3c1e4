"""Stores after killed writers, full disks and missing permissions."""

import fcntl
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.rigs.known_matrix import contents
from tests.services.waiting import wait_until

from rfpipe.errors import LockedError, StoreError
from rfpipe.store import PictureStore, StoreLock, lock, open_arrays, write_arrays
from rfpipe.store.chunks import ChunkedArray
from rfpipe.store.journal import JournalWriter, read_journal

N_ITEMS = 240
# Writes frames that depend only on their index, slowly enough to be killed at any point.
WRITER = """
import sys, time
from pathlib import Path
import numpy as np
from rfpipe.store import PictureStore

path, n_items, in_a_chunk, in_a_file, pause, last = Path(sys.argv[1]), *map(float, sys.argv[2:])
shape = (int(n_items), 40, 50, 3)
chunks = {"items_per_chunk": int(in_a_chunk), "chunks_per_file": int(in_a_file)}
with PictureStore.create(path, shape, "u2", "abc", {}, **chunks) as store:
    for start, stop in store.missing(longest=3):
        rows = [np.random.default_rng(i).integers(0, 4096, shape[1:]) for i in range(start, stop)]
        store.write(start, np.stack(rows).astype("u2"))
        time.sleep(pause if stop < last else 600)
"""
FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from rfpipe.errors import StoreError
from rfpipe.store import PictureStore, write_arrays

frames = np.random.default_rng(0).integers(0, 65536, (4, 200, 200)).astype("u2")
path = Path(sys.argv[1])
write_arrays(path / "bundle", {"a": np.arange(5)}, {})
store = PictureStore.create(path / "s", frames.shape, "u2", "abc", {})
store.write(0, frames[:2])
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
for write in (
    lambda: store.write(2, frames[2:]),
    lambda: write_arrays(path / "bundle", {"a": frames}, {}),
):
    try:
        write()
    except StoreError as error:
        print(error)
store.close()
"""


def running(code: str, path: Path, message: bytes) -> subprocess.Popen[bytes]:
    """Start a program and wait until it prints its first line."""
    program = subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE)
    assert program.stdout is not None
    assert program.stdout.readline() == message
    return program


def start_writer(
    path: Path, chunks: tuple[int, int], pause: float, last: float = np.inf
) -> subprocess.Popen[bytes]:
    """Start a writer, which waits after frame `last` until it is killed."""
    arguments = [str(path), str(N_ITEMS), *map(str, chunks), str(pause), str(last)]
    return subprocess.Popen([sys.executable, "-c", WRITER, *arguments])


def lines_of(journal: Path) -> int:
    return journal.read_bytes().count(b"\n") if journal.exists() else 0


@pytest.mark.parametrize("chunks", [(1, 1), (3, 1), (1, 3)])
def test_killed_writers_resume_to_the_same_bytes(tmp_path: Path, chunks: tuple[int, int]) -> None:
    assert start_writer(tmp_path / "whole", chunks, 0).wait() == 0
    moments = np.random.default_rng(chunks).uniform(0, 0.2, 3)
    path = tmp_path / "s"
    captured = 0
    for n, moment in enumerate(moments, 1):
        writer = start_writer(path, chunks, 0.02, N_ITEMS * n / 4)
        wait_until(lambda: lines_of(path / "journal.jsonl") > captured, "a frame")  # noqa: B023
        time.sleep(moment)
        writer.send_signal(signal.SIGKILL)
        assert writer.wait() == -signal.SIGKILL
        before, captured = captured, int(PictureStore.open(path).done.sum())
        assert before < captured <= N_ITEMS
    assert start_writer(path, chunks, 0).wait() == 0
    assert contents(path) == contents(tmp_path / "whole")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["s", "whole"]


def test_an_orphan_writer_holds_its_lock_until_it_is_killed(tmp_path: Path) -> None:
    code = (
        "import sys, time; from pathlib import Path; from rfpipe.store import StoreLock\n"
        "with StoreLock(Path(sys.argv[1])): print('locked', flush=True); time.sleep(60)"
    )
    with running(code, tmp_path / "s", b"locked\n") as orphan:
        with pytest.raises(LockedError, match=f"process {orphan.pid} is writing this store"):
            StoreLock(tmp_path / "s").acquire()
        orphan.kill()
    with StoreLock(tmp_path / "s"):
        assert (tmp_path / ".s.lock").read_text() == f"{os.getpid()} {socket.gethostname()}\n"
    assert list(tmp_path.iterdir()) == []


def test_acquire_waits_for_the_lock_of_a_crashed_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, waits = tmp_path / "s", []
    with StoreLock(store) as remote_lock:
        (tmp_path / ".s.lock").write_text("4711 node7\n")
        assert str(StoreLock.holder(store)) == "4711 on node7"

        def served(seconds: float) -> None:
            waits.append(seconds)
            if len(waits) == 3:  # the file server releases the lock of the crashed machine
                remote_lock.release()

        monkeypatch.setattr(lock.time, "sleep", served)
        with StoreLock(store):
            assert len(waits) == 3
            assert str(StoreLock.holder(store)) == str(os.getpid())

    with StoreLock(store):
        (tmp_path / ".s.lock").write_text("4711 node7\n")
        monkeypatch.setattr(lock, "_LEASE_SECONDS", -1.0)
        with pytest.raises(LockedError, match="process 4711 on node7 is writing this store"):
            StoreLock(store).acquire()


def test_a_lock_file_removed_by_its_last_holder_is_created_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the last holder removes the file after another process has opened it
    lock_file, flock = tmp_path / ".s.lock", fcntl.flock
    calls: list[int] = []

    def late(descriptor: int, operation: int) -> None:
        if not calls:
            lock_file.unlink()
        calls.append(descriptor)
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    with StoreLock(tmp_path / "s"):
        assert len(calls) == 2
        with pytest.raises(LockedError, match=str(os.getpid())):
            StoreLock(tmp_path / "s").acquire()


def test_a_full_disk_loses_nothing_that_is_captured(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL_DISK, str(tmp_path)]
    errors = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    frames_error, bundle_error = errors.splitlines()
    assert frames_error.startswith("writing the items from 2 on failed: File too large")
    assert f"({tmp_path / 's'})" in frames_error
    assert "80,000 bytes needed" in frames_error
    assert "make room and run again" in frames_error
    assert bundle_error.startswith("writing arrays failed")
    assert f"({tmp_path / 'bundle'})" in bundle_error
    assert open_arrays(tmp_path / "bundle").shape("a") == (5,)
    frames = np.random.default_rng(0).integers(0, 65536, (4, 200, 200)).astype("u2")
    with PictureStore.create(tmp_path / "s", frames.shape, "u2", "abc", {}) as store:
        assert store.missing() == [(2, 4)]
        np.testing.assert_array_equal(store.read(0, 2), frames[:2])
        store.write(2, frames[2:])
        assert store.complete
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bundle", "s"]


def test_a_journal_on_a_full_disk_has_only_complete_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = JournalWriter(tmp_path / "journal")
    journal.append(0, ["aa", "bb"])
    write, accepted = os.write, [7]

    def nearly_full(descriptor: int, content: bytes) -> int:
        if not accepted:
            raise OSError(28, "No space left on device")
        return write(descriptor, content[: accepted.pop()])

    monkeypatch.setattr(os, "write", nearly_full)
    with pytest.raises(StoreError, match="No space left on device"):
        journal.append(2, ["cc"])
    monkeypatch.undo()
    assert lines_of(tmp_path / "journal") == 2
    journal.append(2, ["dd"])
    journal.close()
    assert read_journal(tmp_path / "journal", 9) == {0: "aa", 1: "bb", 2: "dd"}


@pytest.mark.parametrize("items_per_chunk", [1, 2])
def test_an_item_is_in_the_journal_only_once_its_chunk_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, items_per_chunk: int
) -> None:
    frames = np.random.default_rng(0).integers(0, 65536, (6, 3, 4)).astype("u2")
    journal, packed = tmp_path / "s" / "journal.jsonl", ChunkedArray.packed

    def failing(files: ChunkedArray, block: np.ndarray) -> bytes:
        assert read_journal(journal, 6).keys() == {0, 1}
        if (block[0] == frames[4]).all():
            raise OSError(5, os.strerror(5))
        return packed(files, block)

    with PictureStore.create(
        tmp_path / "s", frames.shape, "u2", "abc", {}, items_per_chunk=items_per_chunk
    ) as store:
        store.write(0, frames[:2])
        monkeypatch.setattr(ChunkedArray, "packed", failing)
        with pytest.raises(StoreError, match=r"items from 4 on failed.*Input/output error"):
            store.write(2, frames[2:])
        monkeypatch.undo()
        # nor an item whose block was written partially
        assert store.missing() == [(2, 6)]
        assert read_journal(journal, 6).keys() == {0, 1}
        store.write(2, frames[2:])
        np.testing.assert_array_equal(store.read(0, 6), frames)


def test_a_forbidden_folder_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise OSError(13, os.strerror(13))

    monkeypatch.setattr(os, "open", forbidden)
    for attempt in (
        lambda: PictureStore.create(tmp_path / "s", (2, 3), "u2", "abc", {}),
        lambda: write_arrays(tmp_path / "s", {}, {}),
    ):
        with pytest.raises(
            StoreError, match=r"Permission denied .* give this user write permission"
        ):
            attempt()
