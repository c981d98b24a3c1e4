"""Work on a `dask.distributed` cluster, whose workers share the results' file system."""

from __future__ import annotations

import ipaddress
import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any
from urllib.parse import urlsplit

from rfpipe.config.addresses import check_port
from rfpipe.errors import ClusterError
from rfpipe.stages.jobs.sent import Sent, sending

__all__ = ["Cluster", "connected"]

_SETTING = "resources.workers"
_PATIENCE_SECONDS = 10
# How often to look whether there is still somebody who works, and how long nobody may be: a nanny
# starts a worker that died anew within some seconds.
_LOOK_SECONDS = 5.0
_WITHOUT_WORKERS_SECONDS = 60.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cluster:
    """The workers behind a scheduler.

    Parameters
    ----------
    client : distributed.Client
    address : str
        The scheduler's.
    threads : int
        Of all workers.
    send : callable
        Puts work where the workers see it, see `rfpipe.stages.jobs.sent.sending`.
    """

    client: Any
    address: str
    threads: int
    send: Callable[[Any], Sent]

    def hand_out(self, work: Callable[[int, int], Any]) -> Callable[[int, int], _Promise]:
        """Put the work where each worker reads it, once; return what asks for a piece of it.

        Raises
        ------
        ClusterError
            When a worker doesn't see the folder, or has another rfpipe.
        """
        sent = self.send(work)
        self._check_workers(sent)

        def ask(first: int, last: int) -> _Promise:
            return _Promise(self, self.client.submit(sent, first, last, pure=False))

        return ask

    def _check_workers(self, sent: Sent) -> None:
        found = self.client.run(sent.unfit, on_error="return")
        reasons: dict[str, list[str]] = {}
        for worker, told in found.items():
            reason = told
            if isinstance(told, Exception):  # no rfpipe, or one that knows no such work
                reason = f"can't load this version of rfpipe ({told}). Install it there"
            if reason is not None:
                reasons.setdefault(reason, []).append(worker)
        for reason, workers in reasons.items():
            raise ClusterError(f"{_SETTING} is {self.address}: {', '.join(workers)} {reason}")

    def must_be_there(self, since: float) -> None:
        """Raise ClusterError where there has been nobody to do the work for some time."""
        if self.client.status != "running":
            raise ClusterError(
                f"{_SETTING} {self.address}: the scheduler is gone. What is done is kept: start "
                "one, with workers, and run again"
            )
        waited = monotonic() - since
        if waited > _WITHOUT_WORKERS_SECONDS and not self.client.nthreads():
            raise ClusterError(
                f"{_SETTING} {self.address}: all workers are gone, and none came for "
                f"{_WITHOUT_WORKERS_SECONDS:.0f} s. What is done is kept: start some with 'dask "
                f"worker {self.address}' and run again"
            )


@dataclass(frozen=True)
class _Promise:
    cluster: Cluster
    future: Any  # of distributed

    def result(self) -> Any:
        """Wait for the result, or raise what the work raised."""
        from distributed import KilledWorker

        seen = monotonic()
        while True:
            try:
                return self.future.result(timeout=_LOOK_SECONDS)
            except TimeoutError:
                if self.future.done():  # meanwhile; what it raises is the work's own
                    return self.future.result()
            except (KilledWorker, CancelledError) as error:
                self.cluster.must_be_there(monotonic())
                raise ClusterError(
                    f"{_SETTING} {self.cluster.address}: the work was lost "
                    f"({type(error).__name__}: {error}). Look at the scheduler's and the workers' "
                    "logs; a worker may have too little memory. Then run again, or set "
                    f"{_SETTING} to threads"
                ) from error
            if self.cluster.client.status == "running" and self.cluster.client.nthreads():
                seen = monotonic()
            self.cluster.must_be_there(seen)


@contextmanager
def connected(address: str, folder: Path) -> Iterator[Cluster]:
    """Connect to a scheduler.

    Parameters
    ----------
    address : str
        Such as ``tls://host:8786``, with the certificates that dask's own settings name. Over
        ``tcp://`` to another machine it warns: dask unpickles what it gets.
    folder : Path
        That the workers must see.

    Raises
    ------
    ClusterError
        When none answers, when no worker is there or comes soon, or when there are no certificates
        for TLS.
    """
    import distributed

    try:
        check_port(address)
    except ValueError as error:
        raise ClusterError(f"{_SETTING} is {address}; it {error}") from None
    if address.startswith("tls:"):
        _check_certificates(address)
    elif not _is_here(address):
        _log.warning(
            "%s %s: not encrypted, and dask unpickles what it gets: whoever reaches the scheduler "
            "can run programs there and here. docs/parallel.md tells how to use tls://",
            _SETTING,
            address,
        )
    connect: Any = distributed.Client  # without types
    try:
        client = connect(address, timeout=_PATIENCE_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"{_SETTING} is {address}: no scheduler answers there within "
            f"{_PATIENCE_SECONDS} s ({error}). Start one with 'dask scheduler' and workers with "
            f"'dask worker {address}', correct the address, or set it to threads"
        ) from error
    with client, sending(folder) as send:
        try:  # one that is just being started, or started again
            client.wait_for_workers(1, timeout=_PATIENCE_SECONDS)
        except TimeoutError:
            raise ClusterError(
                f"{_SETTING} is {address}: the scheduler has no workers, and none came within "
                f"{_PATIENCE_SECONDS} s. Start some with 'dask worker {address}', or set it to "
                "threads"
            ) from None
        yield Cluster(client, address, sum(client.nthreads().values()), send)


def _is_here(address: str) -> bool:
    """Whether an address is this machine's own, which others can't listen to."""
    host = urlsplit(address).hostname or ""
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def _check_certificates(address: str) -> None:
    """Raise ClusterError where dask's settings name no certificates for TLS."""
    import dask

    settings = ("ca-file", "client.cert")
    missing = [name for name in settings if not dask.config.get(f"distributed.comm.tls.{name}")]
    if missing:
        raise ClusterError(
            f"{_SETTING} is {address}: dask's settings name no {' and no '.join(missing)} "
            "under distributed.comm.tls. Set them in ~/.config/dask/distributed.yaml or as "
            "environment variables, such as DASK_DISTRIBUTED__COMM__TLS__CA_FILE "
            "(docs/parallel.md)"
        )
