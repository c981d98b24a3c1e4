"""Snakemake's lock of a run's folder, removed automatically after its holder was killed.

Snakemake's lock files don't name the process that made them. A run therefore holds a `StoreLock`
beside them, which the system releases however the process ends, and records the inodes and times of
Snakemake's lock files. If that lock is free and the same files still exist, the run was killed.
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
_HELD = "rfpipe_run"  # names the lock
_RECORD = "rfpipe_run.json"
_NAME_LENGTH = 200


def hold(folder: Path = Path()) -> None:
    """Hold the lock of a run until this process ends, and record Snakemake's lock files.

    Does nothing where another run, of other targets in the same folder, holds it.
    """
    home = folder / _SNAKEMAKE
    with suppress(LockedError):
        StoreLock(home / _HELD).acquire()
        write_manifest(home / _RECORD, {"locks": _lock_files(home)})


def free_if_dead(folder: Path, unlocking: str | None) -> bool:
    """Remove Snakemake's lock of a run that was killed; return True if there was such a lock.

    Parameters
    ----------
    folder : Path
        The run's.
    unlocking : str or None
        The command that removes a lock of unknown origin, for the message; None for that command.

    Raises
    ------
    LockedError
        When another run works in the folder, or that isn't known.
    """
    home = folder / _SNAKEMAKE
    if not _lock_files(home):
        return False
    lock = StoreLock(home / _HELD)
    holder = StoreLock.holder(home / _HELD)
    if holder is not None:
        raise LockedError(
            f"{folder.absolute()}: process {holder} is running the workflow in this folder; wait "
            "until it ends, or end it, then run again"
        )
    with lock:  # two concurrent runs don't remove each other's locks
        present = _lock_files(home)
        if not present:
            return False
        if present != _recorded(home):
            if unlocking is None:
                return False
            raise LockedError(
                f"{folder.absolute()}: this folder is locked by a Snakemake that isn't known here: "
                "it still runs, or was killed before its first job. If it still runs, wait until "
                f"it ends; if it doesn't, free the folder with: {unlocking}"
            )
        shutil.rmtree(home / _LOCKS)
    return True


def unrecorded(folder: Path) -> list[str]:
    """Acquisitions of a run whose settings Snakemake has no record of, ``SCENE/METHOD``.

    Without these records, which lie in ``.snakemake`` beside ``results``, Snakemake takes complete
    results for those of today's settings.
    """
    metadata = folder / _SNAKEMAKE / "metadata"
    names = [
        "/".join(path.parts[-3:-1]) for path in sorted(folder.glob("results/*/*/transport.json"))
    ]
    return [name for name in names if not _has_record(metadata, f"results/{name}/transport.json")]


def _has_record(metadata: Path, output: str) -> bool:
    """Whether Snakemake has a record of an output; it divides the names of long ones."""
    name = urlsafe_b64encode(output.encode()).decode()
    if len(name) > _NAME_LENGTH:
        return metadata.is_dir()
    return (metadata / name).exists()


def _lock_files(home: Path) -> dict[str, list[int]]:
    """Inode and time of each of Snakemake's lock files."""
    files = {}
    for path in sorted((home / _LOCKS).glob("*.lock")):
        with suppress(FileNotFoundError):
            about = path.stat()
            files[path.name] = [about.st_ino, about.st_mtime_ns]
    return files


def _recorded(home: Path) -> dict[str, list[int]] | None:
    """Lock files of the last run that held the lock."""
    try:
        locks: dict[str, list[int]] = read_manifest(home / _RECORD)["locks"]
    except (StoreError, KeyError):
        return None
    return locks
