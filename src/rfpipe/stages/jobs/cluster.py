"""Work on a `dask.distributed` cluster, whose workers share the results' file system."""

from __future__ import annotations

import ipaddress
import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from rfpipe.config.addresses import check_port
from rfpipe.errors import ClusterError
from rfpipe.provenance import code_fingerprint

__all__ = ["Cluster", "connected"]

_PATIENCE_SECONDS = 10

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
    """

    client: Any
    address: str
    threads: int

    def hand_out(self, work: Callable[[int, int], Any]) -> Callable[[int, int], _Promise]:
        """Send the work to each worker, once; return what asks for a piece of it."""
        everywhere = self.client.scatter(work, broadcast=True, hash=False)

        def ask(first: int, last: int) -> _Promise:
            future = self.client.submit(_do, everywhere, first, last, pure=False)
            return _Promise(future, self.address)

        return ask


@dataclass(frozen=True)
class _Promise:
    future: Any  # of distributed
    address: str

    def result(self) -> Any:
        """Wait for the result, or raise what the work raised."""
        from distributed import KilledWorker

        try:
            return self.future.result()
        except (KilledWorker, CancelledError) as error:
            raise ClusterError(
                f"resources.cluster {self.address}: the work was lost ({type(error).__name__}: "
                f"{error}). Look at the scheduler's and the workers' logs; a worker may have too "
                "little memory. Then run again, or set resources.cluster to null"
            ) from error


def _do(work: Callable[[int, int], Any], first: int, last: int) -> Any:
    return work(first, last)


@contextmanager
def connected(address: str) -> Iterator[Cluster]:
    """Connect to a scheduler.

    Parameters
    ----------
    address : str
        Such as ``tls://host:8786``, with the certificates that dask's own settings name. Over
        ``tcp://`` to another machine it warns: dask unpickles what it gets.

    Raises
    ------
    ClusterError
        When none answers, when it has no workers, when a worker has another version of rfpipe, or
        when there are no certificates for TLS.
    """
    import distributed

    try:
        check_port(address)
    except ValueError as error:
        raise ClusterError(f"resources.cluster is {address}; it {error}") from None
    if address.startswith("tls:"):
        _check_certificates(address)
    elif not _is_here(address):
        _log.warning(
            "resources.cluster %s: not encrypted, and dask unpickles what it gets: whoever reaches "
            "the scheduler can run programs there and here. docs/performance.md tells how to use "
            "tls://",
            address,
        )
    connect: Any = distributed.Client  # without types
    try:
        client = connect(address, timeout=_PATIENCE_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"resources.cluster is {address}: no scheduler answers there within "
            f"{_PATIENCE_SECONDS} s ({error}). Start one with 'dask scheduler' and workers with "
            f"'dask worker {address}', correct the address, or set it to null to work here"
        ) from error
    with client:
        threads = sum(client.nthreads().values())
        if not threads:
            raise ClusterError(
                f"resources.cluster is {address}: the scheduler has no workers. Start some with "
                f"'dask worker {address}', or set it to null to work here"
            )
        ours = code_fingerprint("rfpipe")
        others = [
            worker
            for worker, theirs in client.run(code_fingerprint, "rfpipe").items()
            if theirs != ours
        ]
        if others:
            raise ClusterError(
                f"resources.cluster is {address}: {', '.join(others)} run another version of "
                "rfpipe, which may give other results. Install this one there and restart them"
            )
        yield Cluster(client, address, threads)


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
            f"resources.cluster is {address}: dask's settings name no {' and no '.join(missing)} "
            "under distributed.comm.tls. Set them in ~/.config/dask/distributed.yaml or as "
            "environment variables, such as DASK_DISTRIBUTED__COMM__TLS__CA_FILE "
            "(docs/performance.md)"
        )
