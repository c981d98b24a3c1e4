"""Output files: written completely or not at all, in the format of their suffix.

Every command writes through `whole_file`. `OUTPUTS` lists the formats of each command.
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
from rfpipe.platforms import sync

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FORBIDDEN = (errno.EACCES, errno.EPERM, errno.EROFS)
_BLOCKED = (errno.EEXIST, errno.ENOTDIR)
_LOCKLESS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)

FORMATS = {
    ".exr": "radiance, float32",
    ".png": "8 bits, sRGB, to look at",
    ".npy": "all pictures as one NumPy array",
    ".mp4": "a movie",
    ".lp": "directions of lights",
    ".ptm": "a polynomial texture map",
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
"""Stands for a folder among suffixes."""

OUTPUTS: dict[str, tuple[str, ...]] = {
    "relight": (".exr", ".png", ".npy", ".mp4", FOLDER),
    "export": (".npz", ".h5", ".hdf5", ".mat", ".exr"),
    "export --normals": (".exr", ".png"),
    "export --photographs": (FOLDER,),
    "export --relight": (".ptm", FOLDER),
    "movie": (".mp4",),
    "compare": (".csv", ".tex"),
    "view": (".html",),
    "fit": (".zarr",),
    "lights": (".lp",),
    "patterns": (FOLDER,),
    "calibrate": (FOLDER,),
    "publish": (".zip", FOLDER),
    "collection pack": (FOLDER,),
    "collection unpack": (FOLDER,),
}
"""Suffixes that the option ``--output`` of each command may have."""


def is_full(error: OSError) -> bool:
    """Return True for the errors of a full disk, an exceeded quota, and a limit on file sizes."""
    return error.errno in _FULL


class WriteFailure(NamedTuple):
    """Cause of a failed write, and the remedy."""

    reason: str
    remedy: str


def suffix_of(path: Path, allowed: tuple[str, ...], command: str = "") -> str:
    """Return the suffix of an output's name, in lower case; `FOLDER` for a folder.

    The name of a folder has no suffix of letters (``relit``, ``crate-1.0``), or the folder exists.

    Raises
    ------
    InputError
        When the suffix is not allowed, a folder exists in place of the file, or a file or device
        in place of the folder.
    """
    suffix = path.suffix.lower()
    if not suffix[1:2].isalpha() or (path.is_dir() and suffix not in FORMATS):
        suffix = FOLDER
    if suffix not in allowed:
        problem = f"has the suffix {path.suffix}" if suffix else "has no suffix"
        expected = [f"{name} ({FORMATS[name]})" for name in allowed if name != FOLDER]
        if FOLDER in allowed:
            expected.append("a folder's name, without a suffix")
        option = f"rfpipe {command} --output {shlex.quote(str(path))}" if command else f"{path}"
        raise InputError(f"{option}: {problem}; expected {', '.join(expected)}")
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
    """Raise InputError if a file or device exists in place of a folder or of one above it."""
    for folder in (path, *path.parents):
        if folder.exists() and not folder.is_dir():
            kind = "a file" if folder.is_file() else "a device"
            subject = f"{folder}: is" if folder == path else f"{path}: {folder} is"
            raise InputError(f"{subject} {kind}; name a folder, or one that can be created")


def checked_output(command: str, path: Path) -> str:
    """Return the suffix of a command's output; InputError if it isn't in `OUTPUTS`."""
    return suffix_of(path, OUTPUTS[command], command)


def check_no_run(path: Path, mark: str) -> None:
    """Raise InputError for the folder of a run or its results, unless it has a file `mark`."""
    is_results = path.absolute().name == "results" and any(path.glob("*/*/L00"))
    if (is_results or (path / "results").is_dir()) and not (path / mark).exists():
        raise InputError(
            f"{path}: is the folder of a run, with results; name another folder, such as a new one "
            "next to it"
        )


@contextmanager
def storage_errors(
    path: Any, action: str, needed_bytes: int = 0, *, resumes: bool = True
) -> Iterator[None]:
    """Turn an OSError into a StoreError with a remedy.

    Parameters
    ----------
    path : Path or Place
        File, folder or store that is read or written.
    action : str
        Description of the access, such as ``"writing items 3 to 7"``.
    needed_bytes : int
        Size of the data before compression; 0 if irrelevant.
    resumes : bool
        True if a second run continues where this one stopped.
    """
    try:
        yield
    except OSError as error:
        reason, remedy = _failure(path, error, needed_bytes, resumes=resumes)
        raise StoreError(f"{action} failed: {reason}", place=path, remedy=remedy) from error


def _failure(path: Any, error: OSError, needed_bytes: int, *, resumes: bool) -> WriteFailure:
    """Return the cause of an error of the file system, and the remedy."""
    reason = error.strerror or str(error)
    if is_full(error):
        needed = f"{needed_bytes:,} bytes needed, " if needed_bytes else ""
        resumption = ": it continues where it stopped" if resumes else ""
        disk = f"{free_bytes(path.parent):,} bytes free on the disk at {mount_point(path)}"
        remedy = f"{needed}{disk}; make room and run again{resumption}"
        return WriteFailure(reason, remedy)
    if error.errno in _FORBIDDEN:
        return WriteFailure(
            reason,
            f"give this user write permission for {path.parent}, or choose another folder",
        )
    if error.errno in _BLOCKED:
        return WriteFailure(
            reason,
            f"a folder in {path} has the name of a file; remove the file or choose another path",
        )
    if error.errno == errno.ENOENT and isinstance(path, Path):
        parent = _existing(path.absolute().parent)
        return WriteFailure(reason, f"check that {parent} is writable, or choose another folder")
    if error.errno in _LOCKLESS:
        return WriteFailure(
            reason, "mount the file system with locks (NFS 4, Lustre with -o flock)"
        )
    return WriteFailure(reason, "check the folder and its file system, then run again")


def write_atomically(path: Path, content: bytes, *, resumes: bool = True) -> None:
    """Replace a small file atomically, also if the power fails; parameters as `whole_file`."""
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

    The temporary name has the suffix of `path`, from which some writers choose the format. The
    file is synced to the disk and checked before it is renamed. An interrupted write leaves
    nothing.

    Parameters
    ----------
    path : Path
        The file; folders above it are created. The target of a symbolic link is written.
    needed_bytes, resumes
        As in `storage_errors`.
    least_bytes : int
        Size of the smallest complete file.
    check : callable, optional
        Reads the temporary file and raises an error if it is damaged.

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
            sync(partial)
            if partial.stat().st_size < least_bytes:
                raise damage_of(path, partial, "it is truncated")
            if check is not None:
                check(partial)
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)


def damage_of(path: Path, partial: Path, damage: str) -> OSError:
    """Return an error for a library that wrote a damaged file without raising one.

    A disk with less free space than the size of the file counts as full.
    """
    size = partial.stat().st_size if partial.exists() else 0
    if free_bytes(path.parent) <= size:
        return OSError(errno.ENOSPC, f"{os.strerror(errno.ENOSPC)}: {damage}")
    return OSError(errno.EIO, f"the file is damaged: {damage}")


class Sink(io.RawIOBase):
    """A file for libraries that crash on errors of the disk.

    It stores the first error in `failure` instead of raising it, and discards all further bytes.
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
        with self._storing_errors():
            self._file.truncate(size)
        return size or 0

    def write(self, content: Any) -> int:
        """Write all bytes, or none after an error; return their number."""
        with self._storing_errors():
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
    def _storing_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = self.failure or error


def free_bytes(folder: Path) -> int:
    """Return the free bytes on the file system of a folder, which may not exist yet."""
    return shutil.disk_usage(_existing(folder)).free


def mount_point(path: Path) -> Path:
    """Return the folder at which the disk of a file is mounted."""
    folder = _existing(path.absolute().parent)
    while folder != folder.parent and not os.path.ismount(folder):
        folder = folder.parent
    return folder


def _existing(folder: Path) -> Path:
    """Return a folder, or the lowest one above it that exists."""
    while not folder.exists():
        folder = folder.parent
    return folder
