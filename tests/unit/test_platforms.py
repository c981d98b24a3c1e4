"""Systems other than Linux, emulated: modules, functions and rules of files that differ.

Nobody has run rfpipe on Windows or macOS (docs/platforms.md).
"""

from __future__ import annotations

import ast
import errno
import fcntl
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake.script import PythonScript

from rfpipe import platforms
from rfpipe.devices.window import WindowProjector
from rfpipe.errors import CaptureError, LockedError
from rfpipe.jobs.forked_scripts import fork_scripts
from rfpipe.jobs.workers import machine_memory_mb
from rfpipe.output import mount_point, write_atomically
from rfpipe.store import StoreLock, to_disk
from rfpipe.store.journal import JournalWriter, read_journal

SOURCES = Path(platforms.__file__).parent

ABSENT_ON_WINDOWS = """
import multiprocessing, os, psutil, signal, sys  # psutil has its own modules for each system
for name in ("fcntl", "grp", "pwd", "resource", "termios"):
    sys.modules[name] = None
for name in ("fork", "geteuid", "getuid", "mkfifo", "sched_getaffinity", "sysconf"):
    delattr(os, name)
for name in ("SIGCHLD", "SIGHUP", "SIGKILL"):
    delattr(signal, name)
multiprocessing.set_start_method("spawn")
"""
"""Removes what Windows doesn't have from a process."""

USES = {
    "the package": "import rfpipe",
    "the commands": "from rfpipe.cli import app",
    "the workflow": "import rfpipe.jobs.forked_scripts, rfpipe.stages.job, rfpipe.report",
    "an acquisition": (
        "import numpy as np, rfpipe\n"
        "rig = rfpipe.OperatorRig(np.eye(4), camera_shape=(2, 2), projector_shape=(2, 2))\n"
        "assert rfpipe.acquire(rig, method='brute_force', progress=False).patterns == 4"
    ),
}


@pytest.mark.parametrize("use", USES)
def test_a_use_needs_nothing_that_windows_does_not_have(use: str) -> None:
    subprocess.run([sys.executable, "-c", ABSENT_ON_WINDOWS + USES[use]], check=True, timeout=120)


ALLOWED = {
    "fcntl": set(),
    "grp": set(),
    "msvcrt": set(),
    "pwd": set(),
    "resource": set(),
    "termios": set(),
    "os.fork": {"jobs/fork_server.py"},
    "os.waitpid": {"jobs/fork_server.py"},
    "os.getuid": {"caches.py"},
    "os.killpg": set(),
    "os.mkfifo": set(),
    "os.sched_getaffinity": set(),
    "os.sysconf": set(),
    "os.uname": set(),
    "signal.SIGCHLD": {"jobs/fork_server.py"},
    "signal.SIGHUP": set(),
    "signal.SIGKILL": set(),
    "signal.pause": set(),
    "socket.AF_UNIX": set(),
}
"""Modules that may use a name of Linux or Windows alone, after a check of the system."""


def names_in(source: str) -> set[str]:
    """Return the imported modules and the attributes of modules, such as ``os.fork``."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {str(node.module), *(f"{node.module}.{it.name}" for it in node.names)}
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            names.add(f"{node.value.id}.{node.attr}")
    return names


def test_names_of_one_system_are_in_modules_that_check_the_system() -> None:
    scripts = SOURCES.parents[1] / "workflow" / "scripts"
    for path in [*SOURCES.rglob("*.py"), *scripts.glob("*.py")]:
        module = path.relative_to(SOURCES if SOURCES in path.parents else scripts).as_posix()
        forbidden = {name for name, modules in ALLOWED.items() if module not in modules}
        assert not names_in(path.read_text("utf-8")) & forbidden, module


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows' rules of files: no handles of folders, locks by msvcrt, no removal of open files."""

    def locking(descriptor: int, mode: int, length: int) -> None:
        assert (mode, length) == ("LK_NBLCK", 1)
        # locked bytes can't be read by other processes
        assert os.lseek(descriptor, 0, os.SEEK_CUR) > os.fstat(descriptor).st_size
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, "Permission denied") from None

    def open_file(path: Path, flags: int, mode: int = 0o777) -> int:
        if Path(path).is_dir():
            raise PermissionError(errno.EACCES, "Permission denied")
        return real["open"](path, flags, mode)

    def fsync(descriptor: int) -> None:
        if fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
            raise OSError(errno.EBADF, "Bad file descriptor")

    def unlink(path: Path, missing_ok: bool = False) -> None:
        links = [str(link.readlink()) for link in Path("/proc/self/fd").iterdir() if link.exists()]
        if str(path.absolute()) in links:
            raise PermissionError(errno.EACCES, "The file is used by another process")
        real["unlink"](path, missing_ok)

    real = {"open": os.open, "unlink": Path.unlink}
    monkeypatch.setattr(platforms, "IS_WINDOWS", True)
    monkeypatch.setattr(platforms, "_HAS_FLOCK", False)
    msvcrt = SimpleNamespace(LK_NBLCK="LK_NBLCK", locking=locking)
    monkeypatch.setitem(sys.modules, "msvcrt", msvcrt)  # type: ignore[arg-type]
    monkeypatch.setattr(os, "open", open_file)
    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(Path, "unlink", unlink)


@pytest.mark.usefixtures("windows")
class TestWindows:
    """Stores under the emulated rules."""

    def test_a_store_is_locked_once(self, tmp_path: Path) -> None:
        store = tmp_path / "s"
        with StoreLock(store):
            assert StoreLock.holder(store) == str(os.getpid())
            with pytest.raises(LockedError, match=f"process {os.getpid()} is writing"):
                StoreLock(store).acquire()
        assert StoreLock.holder(store) is None
        assert list(tmp_path.iterdir()) == []

    def test_a_lock_file_that_another_process_opened_stays(self, tmp_path: Path) -> None:
        with StoreLock(tmp_path / "s"), (tmp_path / ".s.lock").open() as opened:
            pass
        assert opened.closed
        lock = StoreLock(tmp_path / "s")
        lock.acquire()
        with (tmp_path / ".s.lock").open():
            lock.release()
        with StoreLock(tmp_path / "s"):
            pass
        assert list(tmp_path.iterdir()) == []

    def test_files_and_folders_are_flushed(self, tmp_path: Path) -> None:
        write_atomically(tmp_path / "folder" / "file", b"content")
        to_disk(tmp_path)
        assert (tmp_path / "folder" / "file").read_bytes() == b"content"

    def test_a_journal_is_written_and_read(self, tmp_path: Path) -> None:
        writer = JournalWriter(tmp_path / "journal")
        writer.append(0, ["a", "b"])
        writer.close()
        assert read_journal(tmp_path / "journal", 2) == {0: "a", 1: "b"}


@pytest.mark.parametrize("system", ["darwin", "win32"])
def test_jobs_are_new_processes_where_libraries_cannot_be_forked(
    system: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = PythonScript.execute_script
    monkeypatch.setattr(sys, "platform", system)
    fork_scripts()
    assert PythonScript.execute_script is before


def test_a_window_on_windows_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(CaptureError, match="doesn't run on Windows"):
        WindowProjector()


def test_memory_and_mount_points_are_found_without_posix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = machine_memory_mb()
    monkeypatch.delattr(os, "sysconf")
    monkeypatch.delattr(Path, "is_mount")
    assert machine_memory_mb() == before > 100
    assert mount_point(tmp_path / "file") in tmp_path.parents
