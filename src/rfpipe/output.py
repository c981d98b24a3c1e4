"""Output files: each written whole or not at all, in a format that its suffix names.

Every command writes through `whole_file`. What each command writes is in `OUTPUTS`.
"""

from __future__ import annotations

import errno
import io
import os
import shlex
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from rfpipe.errors import InputError, StoreError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
_BLOCKED = (errno.EEXIST, errno.ENOTDIR)
_LOCKLESS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)

FORMATS = {
    ".exr": "radiance, float32",
    ".png": "8 bits, sRGB, to look at",
    ".npy": "all pictures as one NumPy array",
    ".mp4": "a movie",
    ".npz": "NumPy",
    ".h5": "HDF5",
    ".hdf5": "HDF5",
    ".mat": "MATLAB v7.3",
    ".csv": "a table of numbers",
    ".tex": "a table for LaTeX",
    ".html": "a page",
    ".zarr": "a transport's store",
    ".zip": "one file",
}
"""Contents of files by the suffixes of their names, in lower case."""

FOLDER = ""
"""In place of a suffix: a folder."""

OUTPUTS: dict[str, tuple[str, ...]] = {
    "relight": (".exr", ".png", ".npy", ".mp4", FOLDER),
    "export": (".npz", ".h5", ".hdf5", ".mat", ".exr"),
    "export --normals": (".exr", ".png"),
    "export --photographs": (FOLDER,),
    "movie": (".mp4",),
    "compare": (".csv", ".tex"),
    "view": (".html",),
    "fit": (".zarr",),
    "patterns": (FOLDER,),
    "calibrate": (FOLDER,),
    "publish": (".zip", FOLDER),
    "collection pack": (FOLDER,),
    "collection unpack": (FOLDER,),
}
"""Suffixes that the option ``--output`` of each command may have."""


def is_full(error: OSError) -> bool:
    """Test whether an error is that of a full disk, a quota, or a limit of file sizes."""
    return error.errno in _FULL


class Failure(NamedTuple):
    """Cause of a failed write, and the remedy."""

    reason: str
    remedy: str


def suffix_of(path: Path, allowed: tuple[str, ...], command: str = "") -> str:
    """Return the suffix of an output's name, in lower case; `FOLDER` for a folder.

    A name counts as a folder's when such a folder exists, or it ends in no letters after a full
    stop: ``relit``, ``crate-1.0``.

    Raises
    ------
    InputError
        When the suffix is not allowed, a folder has the name of a file, or a file or device that of
        a folder.
    """
    suffix = path.suffix.lower()
    if not suffix[1:2].isalpha() or (path.is_dir() and suffix not in FORMATS):
        suffix = FOLDER
    if suffix not in allowed:
        has = f"the suffix {path.suffix}" if suffix else "no suffix"
        files = [f"{name} ({FORMATS[name]})" for name in allowed if name != FOLDER]
        expected = ", ".join([*files, *["a folder's name, without a suffix"] * (FOLDER in allowed)])
        option = f"rfpipe {command} --output {shlex.quote(str(path))}" if command else f"{path}"
        raise InputError(f"{option}: has {has}; expected {expected}")
    if suffix not in (FOLDER, ".zarr", ".zip") and path.is_dir():
        raise InputError(f"{path}: is a folder; name a file")
    if suffix == FOLDER:
        check_folder(path)
    else:
        check_folder(path.parent)
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise InputError(f"{path}: is a device; name a file")
    return suffix


def check_folder(path: Path) -> None:
    """Raise InputError where a file or device has the name of a folder, or of one above it."""
    for place in (path, *path.parents):
        if place.exists() and not place.is_dir():
            what = "a file" if place.is_file() else "a device"
            subject = f"{place}: is" if place == path else f"{path}: {place} is"
            raise InputError(f"{subject} {what}; name a folder, or one that can be made")


def checked_output(command: str, path: Path) -> str:
    """Return the suffix of a command's output; InputError unless `OUTPUTS` has it."""
    return suffix_of(path, OUTPUTS[command], command)


def check_no_run(path: Path, mark: str) -> None:
    """Raise InputError where a folder is a run's, or its results, unless it has a file `mark`."""
    is_results = path.absolute().name == "results" and any(path.glob("*/*/L00"))
    if (is_results or (path / "results").is_dir()) and not (path / mark).exists():
        raise InputError(
            f"{path}: is the folder of a run, with results; name another folder, such as a new one "
            "beside it"
        )


@contextmanager
def storage_errors(
    path: Any, action: str, needed_bytes: int = 0, *, resumes: bool = True
) -> Iterator[None]:
    """Turn an OSError into a StoreError that says what to do.

    Parameters
    ----------
    path, action
        The place, and what is done there, such as ``"writing items 3 to 7"``.
    needed_bytes
        Size of the data before compression; 0 when it doesn't matter.
    resumes
        Whether a second run goes on where this one stopped.
    """
    try:
        yield
    except OSError as error:
        reason, remedy = _failure(path, error, needed_bytes, resumes=resumes)
        raise StoreError(f"{action} failed: {reason}", place=path, remedy=remedy) from error


def _failure(path: Any, error: OSError, needed_bytes: int, *, resumes: bool) -> Failure:
    """Return the cause of an error of the file system, and the remedy."""
    reason = error.strerror or str(error)
    if is_full(error):
        needed = f"{needed_bytes:,} bytes needed, " if needed_bytes else ""
        resumption = ": it continues where it stopped" if resumes else ""
        disk = f"{free_bytes(path.parent):,} bytes free on the disk at {mount_point(path)}"
        remedy = f"{needed}{disk}; make room and run again{resumption}"
        return Failure(reason, remedy)
    if error.errno in _FORBIDDEN:
        return Failure(
            reason,
            "expected a place that this user may write to; change the permissions of "
            f"{path.parent} or choose another folder",
        )
    if error.errno in _BLOCKED:
        return Failure(
            reason, f"a file has the name of a folder in {path}; remove it or choose another place"
        )
    if error.errno == errno.ENOENT and isinstance(path, Path):
        parent = _existing(path.absolute().parent)
        return Failure(reason, f"check that files can be made in {parent}, or choose another place")
    if error.errno in _LOCKLESS:
        return Failure(reason, "mount its file system with locks (NFS 4, Lustre with -o flock)")
    return Failure(reason, "check the folder and its file system, then run again")


def write_atomically(path: Path, content: bytes, *, resumes: bool = True) -> None:
    """Write a small file so that it is whole or unchanged, also after a power cut.

    Parameters as `whole_file`.
    """
    with whole_file(path, len(content), resumes=resumes, least_bytes=len(content)) as partial:
        partial.write_bytes(content)


@contextmanager
def whole_file(
    path: Path,
    needed_bytes: int = 0,
    *,
    resumes: bool = False,
    least_bytes: int = 1,
    check: Callable[[Path], object] | None = None,
) -> Iterator[Path]:
    """Yield the path of a temporary file, which replaces `path` when it is complete.

    The name ends as `path` does, since some writers tell the format by it. The file is brought to
    the disk and checked before it gets its name. An interrupted write leaves nothing.

    Parameters
    ----------
    path
        The file; folders above it are made. A symbolic link stays, and its target is written.
    needed_bytes, resumes
        As in `storage_errors`.
    least_bytes
        Size of the smallest file that is complete.
    check : callable, optional
        Reads the temporary file back, and raises an error where it is damaged.

    Raises
    ------
    StoreError
        When the disk is full or the folder isn't writable, or the file is damaged.
    """
    path = path.resolve() if path.is_symlink() else path
    partial = path.with_name(f".partial-{path.name}")
    with storage_errors(path, "writing", needed_bytes, resumes=resumes):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield partial
            with partial.open("rb") as file:
                os.fsync(file.fileno())
            if partial.stat().st_size < least_bytes:
                raise damage_of(path, partial, "it is cut")
            if check is not None:
                check(partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def damage_of(path: Path, partial: Path, what: str) -> OSError:
    """Return the error of a library that wrote a damaged file without raising one.

    It is that of a full disk where the disk has less room than the file has bytes.
    """
    size = partial.stat().st_size if partial.exists() else 0
    if free_bytes(path.parent) <= size:
        return OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {what}")
    return OSError(errno.EIO, f"the file is damaged: {what}")


class Sink(io.RawIOBase):
    """A file for libraries that crash on errors of the disk: it keeps the first error.

    After an error, further bytes are discarded, and `failure` has the error to raise.
    """

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__()
        self._file = file
        self.failure: OSError | None = None

    def readable(self) -> bool:
        """True."""
        return True

    def seekable(self) -> bool:
        """True."""
        return True

    def writable(self) -> bool:
        """True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read into a buffer; return the number of bytes."""
        return int(self._file.readinto(buffer))  # type: ignore[attr-defined]

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Change the position; return it."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the position."""
        return self._file.tell()

    def truncate(self, size: int | None = None) -> int:
        """Resize the file."""
        with self._kept_errors():
            self._file.truncate(size)
        return size or 0

    def write(self, content: Any) -> int:
        """Write all bytes, or none after an error; return their number."""
        with self._kept_errors():
            if self.failure is None:
                view = memoryview(content).cast("B")
                while view:
                    view = view[self._file.write(view) :]
        return len(content)

    def raise_failure(self) -> None:
        """Raise the first error, if there was one."""
        if self.failure is not None:
            raise self.failure

    @contextmanager
    def _kept_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = self.failure or error


def free_bytes(folder: Path) -> int:
    """Return the bytes free on the file system of a folder, which needn't exist yet."""
    return shutil.disk_usage(_existing(folder)).free


def mount_point(path: Path) -> Path:
    """Return the folder at which the disk of a file is mounted."""
    place = _existing(path.absolute().parent)
    while place != place.parent and not place.is_mount():
        place = place.parent
    return place


def _existing(folder: Path) -> Path:
    while not folder.exists():
        folder = folder.parent
    return folder
