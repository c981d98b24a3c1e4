"""Work on its way to other processes: in a file of a folder that they must see anyway."""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any
from uuid import uuid4

from rfpipe.errors import ClusterError
from rfpipe.provenance import code_digest, fingerprint, versions
from rfpipe.store.files import digest_of, write_atomically

__all__ = ["Sent", "sending"]


@dataclass(frozen=True)
class Sent:
    """Work that lies in a file, to be called in any process that sees it.

    A process reads it once, so that a piece of work costs a message of some hundred bytes, and
    another process can do it again where the first one died.

    Attributes
    ----------
    path : Path
        Absolute; removed by whoever sent it, after which no piece begins.
    digest : str
        Of the file.
    code : str
        Fingerprint of the sender's rfpipe and of the packages that shape numbers.
    """

    path: Path
    digest: str
    code: str

    def __call__(self, first: int, last: int) -> Any:
        """Do a piece of the work, with one thread.

        Raises
        ------
        ClusterError
            When this process doesn't see the file, or has another rfpipe.
        """
        _one_thread()
        try:
            unfit = self.unfit()
            if unfit:
                raise ClusterError(f"a worker {unfit}")
            return _read(self.path, self.digest)(first, last)
        except Exception as error:
            raise _portable(error) from None

    def unfit(self) -> str | None:
        """Tell why this process can't do the work, None where it can."""
        if not self.path.is_file():
            return (
                f"does not see {self.path.parent}: workers share the file system with whoever "
                "sends them work, under the same path. Mount it there"
            )
        if self.code != _our_code():
            return (
                "runs another version of rfpipe, Python, numpy, numba or zarr, which may give "
                "other results. Install the same there and restart it"
            )
        return None


@contextmanager
def sending(folder: Path) -> Iterator[Callable[[Callable[[int, int], Any]], Sent]]:
    """Provide what puts work into a folder, for as long as it takes.

    Parameters
    ----------
    folder : Path
        One that the work reads from or writes to; made where it is missing.

    Raises
    ------
    StoreError
        When nothing can be written there.
    """
    sent: list[Path] = []

    def send(work: Callable[[int, int], Any]) -> Sent:
        import cloudpickle

        content = cloudpickle.dumps(work)
        path = folder.absolute() / f".work.{uuid4().hex}"
        write_atomically(path, content)
        sent.append(path)
        return Sent(path, digest_of(content), _our_code())

    try:
        yield send
    finally:
        for path in sent:
            path.unlink(missing_ok=True)


@lru_cache(maxsize=1)
def _read(path: Path, digest: str) -> Callable[[int, int], Any]:
    """Read work; what it keeps open is kept until this process gets other work."""
    content = path.read_bytes()
    if digest_of(content) != digest:
        raise ClusterError(f"{path}: isn't the work that was sent; run again")
    work: Callable[[int, int], Any] = pickle.loads(content)
    return work


@cache
def _our_code() -> str:
    return fingerprint([code_digest(), versions()])


def _one_thread() -> None:
    """Let compiled kernels use one thread: their pieces are what is done side by side.

    What has its threads already, as where workers are threads of one's own process, refuses
    another number in the environment at the next kernel that it compiles.
    """
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(1)  # of this thread alone
    else:
        os.environ.setdefault("NUMBA_NUM_THREADS", "1")


def _portable(error: Exception) -> Exception:
    """Return an error as another process can have it: itself, or its name and message."""
    with suppress(Exception):
        pickle.loads(pickle.dumps(error))
        return error
    return RuntimeError(f"{type(error).__name__}: {error}")
