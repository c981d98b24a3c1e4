"""Lease of the rig, and the thread that executes the captures of requests."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from starlette.exceptions import HTTPException

from rfpipe.errors import CaptureError, InputError
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch, sequence_patterns
from rfpipe.rigs.devices import check_frame_shape
from rfpipe.rigs.messages import Message, Metrics, PackedPatterns
from rfpipe.units import picture_name

_log = logging.getLogger("rfpipe.server")

_STORED_CAPTURES = 2  # captures whose brackets are stored for repeated requests


def _retry_later(status: int, detail: str) -> HTTPException:
    return HTTPException(status, detail, {"Retry-After": "1"})


class Leases:
    """The lease of a rig, of which there is one at a time; thread-safe.

    Parameters
    ----------
    seconds : float
        Duration of a lease without a heartbeat.
    clock : callable
        Monotonic clock, returns seconds.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.seconds = seconds
        self._clock = clock
        self._identity, self._client, self._until = "", "", clock()
        self._lock = threading.Lock()

    @property
    def holder(self) -> str | None:
        """Name of the client that holds the rig, None if it is free."""
        return self._client if self._clock() < self._until else None

    def acquire(self, client: str) -> str:
        """Acquire the rig and return the secret of the lease; status 409 if it isn't free."""
        with self._lock:
            if self.holder is not None:
                remaining = self._until - self._clock()
                raise _retry_later(
                    409,
                    f"the rig is held by {self._client!r}, for another {remaining:.1f} s if it "
                    "sends no heartbeat; wait until it is released",
                )
            self._identity, self._client = secrets.token_urlsafe(24), client
            self._until = self._clock() + self.seconds
            return self._identity

    def renew(self, identity: str, seconds: float | None = None) -> str:
        """Renew the lease and return the name of its client; status 410 if it isn't valid.

        `seconds` is the duration of the lease from now on, 0 to release the rig.
        """
        with self._lock:
            if not self.is_held_by(identity):
                raise HTTPException(
                    410,
                    "this lease is not valid: it expired, or the server was restarted; acquire a "
                    "new one",
                )
            self._until = self._clock() + (self.seconds if seconds is None else seconds)
            return self._client

    def is_held_by(self, identity: str) -> bool:
        """Test whether this lease is valid."""
        given, valid = (key.encode("utf-8", "surrogatepass") for key in (identity, self._identity))
        return self.holder is not None and secrets.compare_digest(given, valid)


@dataclass
class _Capture:
    """A request for brackets; `message` has the brackets of the first `exposed` patterns."""

    digest: str
    lease: str
    message: Message
    result: Future[bytes]
    exposed: int = 0


class RigWorker:
    """Executes captures one after the other, in one thread that uses the rig.

    Parameters
    ----------
    rig : Rig, or callable that returns one
        A callable is called in the thread that uses the rig, as some windows and drivers require.
    leases : Leases
        A capture ends before its next pattern when its lease isn't valid any more.

    Raises
    ------
    RfpipeError
        When the rig can't be opened.
    """

    def __init__(self, rig: Rig | Callable[[], Rig], leases: Leases) -> None:
        self.leases = leases
        self._captures: dict[str, _Capture] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._is_closed = False
        self._thread = ThreadPoolExecutor(1, "rig")
        self.metrics = Metrics()
        try:
            self.rig: Rig = self._thread.submit(rig).result() if callable(rig) else rig
        except BaseException:
            self._thread.shutdown()
            raise

    def check_free(self, identity: str) -> None:
        """Raise status 429 for a new capture while another one is running.

        Called before the body of a request is read.
        """
        with self._lock:
            if identity not in self._captures:
                self._check_free()

    def submit(
        self, identity: str, digest: str, lease: str, patterns: Callable[[], PackedPatterns]
    ) -> Future[bytes]:
        """Start the capture of a request, or return the running one of a repeated request.

        Not thread-safe.

        Parameters
        ----------
        identity : str
            Identifier of the request, the same when it is repeated.
        digest : str
            Digest of its content.
        lease : str
        patterns : callable
            Returns the validated patterns; called if they have to be exposed.

        Returns
        -------
        Future
            Message with the brackets. Raises CaptureError, InputError, or HTTPException 503 when
            the server stops or the lease expired; exposed brackets are stored then, and a
            repetition of the request continues after them.

        Raises
        ------
        HTTPException
            429 while another capture is running, 422 when the identifier was used with another
            content.
        """
        with self._lock:
            capture = self._captures.get(identity)
            if capture is not None and capture.digest != digest:
                raise HTTPException(
                    422, "this Idempotency-Key was used with other patterns; send a new one"
                )
            if capture is not None:
                capture.lease = lease
                if not (capture.result.done() and capture.result.exception()):
                    return capture.result
        packed = patterns()
        with self._lock:
            self._check_free()
            if capture is None:
                self._forget(_STORED_CAPTURES - 1)
                message = Message({"keys": packed.keys})
                capture = self._captures[identity] = _Capture(digest, lease, message, Future())
            capture.result = self._thread.submit(self._expose, capture, packed)
            return capture.result

    def forget(self) -> None:
        """Delete the brackets stored for repeated requests, after their client is done."""
        with self._lock:
            self._forget(0)

    def stop(self) -> None:
        """Stop after the pattern that is being exposed; may be called by a signal handler."""
        self._stopping.set()

    @property
    def is_stopping(self) -> bool:
        """True if the worker exposes no further patterns."""
        return self._stopping.is_set()

    def close(self) -> None:
        """Stop, wait for the current exposure, and close the rig; further calls have no effect."""
        self.stop()
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
        try:
            self._thread.submit(getattr(self.rig, "close", lambda: None)).result()
        finally:
            self._thread.shutdown()

    def _check_free(self) -> None:
        busy = [capture for capture in self._captures.values() if not capture.result.done()]
        # a capture with an expired lease ends before its next pattern, so that one may wait for it
        if len(busy) >= 2 or any(self.leases.is_held_by(capture.lease) for capture in busy):
            raise _retry_later(429, "another capture is running; send one request at a time")

    def _forget(self, count: int) -> None:
        """Delete all finished captures except the latest `count`."""
        done = [name for name, capture in self._captures.items() if capture.result.done()]
        for name in done[: max(0, len(done) - count)]:
            del self._captures[name]

    def _expose(self, capture: _Capture, patterns: PackedPatterns) -> bytes:
        """Expose the patterns without brackets, in hardware sequences if the rig has them."""
        step = max(1, sequence_patterns(self.rig))
        for first in range(capture.exposed, len(patterns), step):
            if self.is_stopping:
                raise _retry_later(503, "the server is stopping; repeat the request later")
            if not self.leases.is_held_by(capture.lease):
                raise _retry_later(
                    503,
                    "the lease expired during the capture; acquire a new one and repeat the "
                    "request",
                )
            last = min(first + step, len(patterns))
            keys = patterns.keys[first:last]
            brackets = self._brackets(patterns.expanded(first, last), keys)
            self.metrics.brackets += last - first
            for index, bracket in enumerate(brackets, first):
                capture.message.add(str(index), bracket)
            capture.exposed = last
        content, capture.message = capture.message.content(), Message({})  # frees the memory
        return content

    def _brackets(
        self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]
    ) -> NDArray[Any]:
        """Capture brackets; log and count failures."""
        rig = self.rig
        try:
            shape = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
            brackets = capture_batch(rig, patterns, keys)
            return check_frame_shape(brackets, (len(keys), *shape), rig.sensor.frame_dtype)
        except InputError:
            raise
        except Exception as error:
            self.metrics.failures += 1
            self.metrics.last_error = f"{picture_name(keys[0])}: {error}"
            _log.exception("the rig failed at %s", picture_name(keys[0]))
            if isinstance(error, CaptureError):
                raise
            raise CaptureError(f"the rig failed: {type(error).__name__}: {error}") from error
