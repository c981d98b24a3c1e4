"""Work on a `dask.distributed` cluster, whose workers share the results' file system.

Work lies in a file of the folder that it reads or writes. A worker reads it once, a piece of it is
a message of some hundred bytes, and another worker can do the piece where one died.
"""

from __future__ import annotations

import logging
import os
import pickle
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from time import monotonic
from typing import Any
from urllib.parse import urlsplit
from uuid import uuid4

from rfpipe.config.addresses import check_port
from rfpipe.errors import ClusterError
from rfpipe.provenance import code_digest, fingerprint, versions
from rfpipe.store.files import write_atomically

_PATIENCE_SECONDS = 10
# A nanny starts a worker that died anew within some seconds.
_WITHOUT_WORKERS_SECONDS = 60.0
_LOOK_SECONDS = 5.0
_HERE = ("localhost", "127.0.0.1")

_log = logging.getLogger(__name__)

Work = Callable[[int, int], Any]


@contextmanager
def connected(
    address: str, folder: Path
) -> Iterator[tuple[Callable[[Work], Callable[[int, int], Any]], int]]:
    """Connect to a scheduler; provide what hands out work, and the number of its workers' threads.

    Parameters
    ----------
    address : str
        Such as ``tls://host:8786``, with the certificates of dask's own settings.
    folder : Path
        Holds the work as long as it takes; the workers must see it.

    Raises
    ------
    ClusterError
        When no scheduler answers, when it has no workers, or when one doesn't see the folder or
        has another rfpipe.
    """
    import cloudpickle
    import distributed

    setting = f"resources.workers is {address}"
    try:
        check_port(address)
    except ValueError as error:
        raise ClusterError(f"{setting}; it {error}") from None
    if not address.startswith("tls:") and urlsplit(address).hostname not in _HERE:
        text = "%s: not encrypted, and dask unpickles what it gets: use tls:// (docs/parallel.md)"
        _log.warning(text, setting)
    connect: Any = distributed.Client  # without types
    with ExitStack() as stack:
        try:
            client = stack.enter_context(
                connect(address, timeout=_PATIENCE_SECONDS, set_as_default=False)
            )
            client.wait_for_workers(1, timeout=_PATIENCE_SECONDS)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            raise ClusterError(
                f"{setting}: within {_PATIENCE_SECONDS} s no scheduler with workers answered "
                f"({error}). Start both as docs/parallel.md says, with certificates for tls://, or "
                "set it to threads"
            ) from error

        def hand_out(work: Work) -> Callable[[int, int], _Promise]:
            path = folder.absolute() / f".work.{uuid4().hex}"
            write_atomically(path, cloudpickle.dumps(work))
            stack.callback(path.unlink, missing_ok=True)
            unfit = client.run(_unfit, path, _our_code(), on_error="return")
            for worker, reason in unfit.items():
                if reason is not None:  # an exception where there is no rfpipe, or another one
                    raise ClusterError(f"{setting}: {worker} {reason}")

            def ask(first: int, last: int) -> _Promise:
                future = client.submit(_do, path, _our_code(), first, last, pure=False)
                return _Promise(client, future, setting)

            return ask

        yield hand_out, sum(client.nthreads().values())


@dataclass(frozen=True)
class _Promise:
    client: Any
    future: Any  # of distributed
    setting: str

    def result(self) -> Any:
        """Wait for the result, or raise the error of the work; ClusterError where it was lost."""
        from distributed import KilledWorker

        seen = monotonic()
        while True:
            try:
                return self.future.result(timeout=_LOOK_SECONDS)
            except TimeoutError:
                if self.future.done():  # meanwhile, or the error is the work's own
                    return self.future.result()
            except (KilledWorker, CancelledError) as error:
                raise self._lost(f"{type(error).__name__}: {error}") from error
            if self.client.status != "running":
                raise self._lost("the scheduler is gone")
            if self.client.nthreads():
                seen = monotonic()
            elif monotonic() - seen > _WITHOUT_WORKERS_SECONDS:
                raise self._lost("all workers are gone")

    def _lost(self, why: str) -> ClusterError:
        return ClusterError(
            f"{self.setting}: the work was lost ({why}). What is done is kept. See dask's logs, a "
            "worker may have too little memory; start what is missing and run again"
        )


def _do(path: Path, code: str, first: int, last: int) -> Any:
    """Do a piece of the work in a worker, with one thread: pieces are done side by side."""
    if "numba" in sys.modules:
        import numba

        numba.set_num_threads(1)  # of this thread alone
    else:
        os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    unfit = _unfit(path, code)
    if unfit:
        raise ClusterError(f"a worker {unfit}")
    return _read(path)(first, last)


def _unfit(path: Path, code: str) -> str | None:
    """Return why this process can't do the work, or None."""
    if not path.is_file():
        return f"does not see {path.parent}. Mount it there, under the same path"
    if code != _our_code():
        return "runs another version of rfpipe or what it rests on. Install the same and restart it"
    return None


@lru_cache(maxsize=1)
def _read(path: Path) -> Work:
    """Read work; the stores that it opens stay open until this process gets other work."""
    work: Work = pickle.loads(path.read_bytes())
    return work


@cache
def _our_code() -> str:
    return fingerprint([code_digest(), versions()])
