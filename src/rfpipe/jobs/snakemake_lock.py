"""Snakemake's lock of a run's folder, removed automatically after a run was killed.

Snakemake's lock files don't name the process that made them. A run therefore holds a `StoreLock`
next to them, which the operating system releases however the process ends, and records the inodes
and times of Snakemake's lock files. If that lock is free and the same files still exist, the run
was killed.
"""

from __future__ import annotations

import shutil
from base64 import urlsafe_b64encode
from contextlib import suppress
from pathlib import Path

from rfpipe.errors import LockedError, StoreError
from rfpipe.store import StoreLock, read_manifest, write_manifest

_SNAKEMAKE = Path(".snakemake")
_LOCKS = "locks"
_RUN_LOCK = "rfpipe_run"
_RECORD = "rfpipe_run.json"
_NAME_LENGTH = 200


def hold(folder: Path = Path()) -> None:
    """Hold the lock of a run until this process ends, and record Snakemake's lock files.

    Does nothing if another run holds it, with other targets in the same folder.
    """
    home = folder / _SNAKEMAKE
    with suppress(LockedError):
        StoreLock(home / _RUN_LOCK).acquire()
        write_manifest(home / _RECORD, {"locks": _lock_files(home)})


def free_if_dead(folder: Path, unlocking: str | None) -> bool:
    """Remove Snakemake's lock of a run that was killed; return True if there was such a lock.

    Parameters
    ----------
    folder : Path
        Folder of the run.
    unlocking : str or None
        Command that removes a lock of unknown origin, for the message; None while that command
        runs.

    Raises
    ------
    LockedError
        If another run works in the folder, or may do so.
    """
    home = folder / _SNAKEMAKE
    if not _lock_files(home):
        return False
    lock = StoreLock(home / _RUN_LOCK)
    holder = StoreLock.holder(home / _RUN_LOCK)
    if holder is not None:
        raise LockedError(
            f"{folder.absolute()}: process {holder} is running the workflow in this folder",
            remedy="wait until it ends, or end it, then run again",
        )
    with lock:  # two concurrent runs don't remove each other's locks
        present = _lock_files(home)
        if not present:
            return False
        if present != _recorded(home):
            if unlocking is None:
                return False
            raise LockedError(
                f"{folder.absolute()}: this folder is locked by an unknown Snakemake: "
                "it still runs, or was killed before its first job. If it still runs, wait until "
                f"it ends; if it doesn't, free the folder with: {unlocking}"
            )
        shutil.rmtree(home / _LOCKS)
    return True


def unrecorded(folder: Path) -> list[str]:
    """Return the acquisitions whose settings Snakemake has no record of, ``SCENE/METHOD``.

    Without these records, which are in ``.snakemake`` next to ``results``, Snakemake assumes that
    complete results were made with the current settings.
    """
    metadata = folder / _SNAKEMAKE / "metadata"
    names = [
        "/".join(path.parts[-3:-1]) for path in sorted(folder.glob("results/*/*/transport.json"))
    ]
    return [name for name in names if not _has_record(metadata, f"results/{name}/transport.json")]


def _has_record(metadata: Path, output: str) -> bool:
    """Test whether Snakemake has a record of an output; it divides long names into folders."""
    name = urlsafe_b64encode(output.encode()).decode()
    if len(name) > _NAME_LENGTH:
        return metadata.is_dir()
    return (metadata / name).exists()


def _lock_files(home: Path) -> dict[str, list[int]]:
    """Inode and time of each of Snakemake's lock files."""
    files = {}
    for path in sorted((home / _LOCKS).glob("*.lock")):
        with suppress(FileNotFoundError):
            status = path.stat()
            files[path.name] = [status.st_ino, status.st_mtime_ns]
    return files


def _recorded(home: Path) -> dict[str, list[int]] | None:
    """Lock files that the last run recorded; None without a record."""
    try:
        locks: dict[str, list[int]] = read_manifest(home / _RECORD)["locks"]
    except (StoreError, KeyError):
        return None
    return locks
