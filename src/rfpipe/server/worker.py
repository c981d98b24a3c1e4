"""Who holds the rig, the one thread that uses it, and the captures that it was asked for."""

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
from rfpipe.rigs.devices import check_frames
from rfpipe.rigs.messages import Message, Metrics, SentPatterns
from rfpipe.units import picture_name

_log = logging.getLogger("rfpipe.server")

_KEPT = 2  # captures, for requests that come again


def _come_again(status: int, detail: str) -> HTTPException:
    return HTTPException(status, detail, {"Retry-After": "1"})


class Leases:
    """The one lease that a rig has; any thread may ask.

    Parameters
    ----------
    seconds : float
        How long it lasts without a heart-beat.
    clock : callable
        Returns seconds; never runs backwards.
    """

    def __init__(self, seconds: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.seconds = seconds
        self._clock = clock
        self._identity, self._client, self._until = "", "", clock()
        self._lock = threading.Lock()

    @property
    def holder(self) -> str | None:
        """What the client that holds the rig calls itself, if there is one."""
        return self._client if self._clock() < self._until else None

    def acquire(self, client: str) -> str:
        """Take the rig and return the holder's secret; 409 where another has it."""
        with self._lock:
            if self.holder is not None:
                left = self._until - self._clock()
                raise _come_again(
                    409,
                    f"the rig is held by {self._client!r}, and for {left:.1f} s yet if its heart "
                    "stops; wait until it is released",
                )
            self._identity, self._client = secrets.token_urlsafe(24), client
            self._until = self._clock() + self.seconds
            return self._identity

    def renew(self, identity: str, seconds: float | None = None) -> str:
        """Take a heart-beat and return the client; 410 where the lease isn't in force.

        `seconds` is how long the lease lasts from now, 0 to give the rig back.
        """
        with self._lock:
            if not self.is_held_by(identity):
                raise HTTPException(
                    410,
                    "this lease is not in force: it lapsed or the server was started anew; acquire "
                    "again",
                )
            self._until = self._clock() + (self.seconds if seconds is None else seconds)
            return self._client

    def is_held_by(self, identity: str) -> bool:
        """Tell whether this lease is in force."""
        given, known = (one.encode("utf-8", "surrogatepass") for one in (identity, self._identity))
        return self.holder is not None and secrets.compare_digest(given, known)


@dataclass
class _Capture:
    """One request: `message` holds the brackets of the first `exposed` of its patterns."""

    digest: str
    lease: str
    message: Message
    result: Future[bytes]
    exposed: int = 0


class RigWorker:
    """Shows patterns one after the other; whatever thread asks, one thread uses the rig.

    Parameters
    ----------
    rig : Rig, or callable that returns one
        A callable is called in the thread that uses the rig: windows and drivers may want that.
    leases : Leases
        A capture ends before its next pattern when its lease is no longer in force.

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
        """Refuse a new capture by 429 while another is under way.

        Asked before anything of a request is read, or held in memory.
        """
        with self._lock:
            if identity not in self._captures:
                self._check_free()

    def submit(
        self, identity: str, digest: str, lease: str, patterns: Callable[[], SentPatterns]
    ) -> Future[bytes]:
        """Have the patterns of a request exposed, unless it came before; one call at a time.

        Parameters
        ----------
        identity : str
            Of the request; the same when it comes again.
        digest : str
            Of its content.
        lease : str
        patterns : callable
            Returns the patterns, all checked; called where they are to be exposed.

        Returns
        -------
        Future
            Of the message with the brackets. Raises CaptureError, InputError, or HTTPException 503
            where the server stops or the lease lapsed; what was exposed until then is kept, and the
            same request goes on from there.

        Raises
        ------
        HTTPException
            429 while another capture is under way, 422 where the identity was used with another
            content.
        """
        with self._lock:
            before = self._captures.get(identity)
            if before is not None and before.digest != digest:
                raise HTTPException(
                    422, "this Idempotency-Key was used with other patterns; take a new one"
                )
            if before is not None:
                before.lease = lease
                if not (before.result.done() and before.result.exception()):
                    return before.result
        sent = patterns()
        with self._lock:
            self._check_free()
            if before is None:
                self._forget(_KEPT - 1)
                message = Message({"keys": sent.keys})
                before = self._captures[identity] = _Capture(digest, lease, message, Future())
            before.result = self._thread.submit(self._expose, before, sent)
            return before.result

    def forget(self) -> None:
        """Free the brackets kept for requests that may come again: their client is done."""
        with self._lock:
            self._forget(0)

    def stop(self) -> None:
        """Let the pattern that is being exposed be the last one; a signal handler may call it."""
        self._stopping.set()

    @property
    def is_stopping(self) -> bool:
        """Whether no more patterns are exposed."""
        return self._stopping.is_set()

    def close(self) -> None:
        """Stop, wait for the exposure in hand, and close the rig; once."""
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
        # one that has lost its lease ends before its next pattern, and may be waited for by one
        if len(busy) >= 2 or any(self.leases.is_held_by(capture.lease) for capture in busy):
            raise _come_again(429, "another capture is under way; send one at a time")

    def _forget(self, kept: int) -> None:
        """Forget all but the latest captures, and none that is under way."""
        done = [name for name, capture in self._captures.items() if capture.result.done()]
        for name in done[: max(0, len(done) - kept)]:
            del self._captures[name]

    def _expose(self, capture: _Capture, patterns: SentPatterns) -> bytes:
        """Expose the patterns that are missing: by sequences where the rig has them."""
        step = max(1, sequence_patterns(self.rig))
        for first in range(capture.exposed, len(patterns), step):
            if self.is_stopping:
                raise _come_again(503, "the server is being stopped; send it again")
            if not self.leases.is_held_by(capture.lease):
                raise _come_again(503, "the lease lapsed; send it again")
            last = min(first + step, len(patterns))
            keys = patterns.keys[first:last]
            brackets = self._taken(patterns.expanded(first, last), keys)
            self.metrics.brackets += last - first
            for index, bracket in enumerate(brackets, first):
                capture.message.add(str(index), bracket)
            capture.exposed = last
        content, capture.message = capture.message.content(), Message({})  # not held twice
        return content

    def _taken(
        self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]
    ) -> NDArray[Any]:
        rig = self.rig
        try:
            shape = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
            brackets = capture_batch(rig, patterns, keys)
            return check_frames(brackets, (len(keys), *shape), rig.sensor.frame_dtype)
        except InputError:
            raise
        except Exception as error:
            self.metrics.failures += 1
            self.metrics.last_error = f"{picture_name(keys[0])}: {error}"
            _log.exception("the rig failed at %s", picture_name(keys[0]))
            if isinstance(error, CaptureError):
                raise
            raise CaptureError(f"the rig failed: {type(error).__name__}: {error}") from error
