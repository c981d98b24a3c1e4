"""Who holds the rig, the one thread that uses it, and the captures that it was asked for."""

from __future__ import annotations

import logging
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.rigs import Rig
from rfpipe.rigs.base import capture_batch, sequence_patterns
from rfpipe.rigs.devices import check_frames
from rfpipe.rigs.messages import Message, SentPatterns
from rfpipe.rigs.protocol import Metrics

_log = logging.getLogger("rfpipe.server")


class LeaseHeldError(Exception):
    """Another client holds the rig."""


class LeaseLapsedError(Exception):
    """A lease is unknown here: it lapsed, was released, or the server was started anew."""


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
        """Take the rig and return the holder's secret; LeaseHeldError where another has it."""
        with self._lock:
            if self.holder is not None:
                raise LeaseHeldError(
                    f"the rig is held by {self._client!r}, and for "
                    f"{self._until - self._clock():.1f} s yet if its heart stops; wait until it is "
                    "released"
                )
            self._identity, self._client = secrets.token_urlsafe(24), client
            self._until = self._clock() + self.seconds
            return self._identity

    def renew(self, identity: str) -> None:
        """Take a heart-beat; raises LeaseLapsedError where it comes too late."""
        with self._lock:
            self._check(identity)
            self._until = self._clock() + self.seconds

    def release(self, identity: str) -> str:
        """Give the rig back and return the client; LeaseLapsedError where it isn't the holder."""
        with self._lock:
            self._check(identity)
            self._until = self._clock()
            return self._client

    def is_held_by(self, identity: str) -> bool:
        """Tell whether this lease is in force."""
        given, known = (one.encode("utf-8", "surrogatepass") for one in (identity, self._identity))
        return self.holder is not None and secrets.compare_digest(given, known)

    def _check(self, identity: str) -> None:
        if not self.is_held_by(identity):
            raise LeaseLapsedError(
                "this lease is not in force: it lapsed or the server was started anew; acquire "
                "again"
            )


class CaptureConflictError(Exception):
    """A request came again under its key with other patterns."""


class RigBusyError(Exception):
    """Another capture is under way."""


class CaptureStoppedError(Exception):
    """The server is being stopped, or the client's lease lapsed; the rest wasn't exposed."""


class Shown(NamedTuple):
    """The last bracket: its number since the start, its pattern's key and its frames."""

    number: int
    key: tuple[int, ...]
    bracket: NDArray[Any]


@dataclass
class _Capture:
    """One request: `message` holds the brackets of the first `exposed` of its patterns."""

    digest: str
    lease: str
    message: Message
    exposed: int = 0
    result: Future[bytes] | None = None

    @property
    def is_under_way(self) -> bool:
        """Whether it was begun and goes on."""
        return self.result is not None and not self.result.done()

    @property
    def has_failed(self) -> bool:
        """Whether it ended before its last pattern."""
        return self.result is not None and self.result.done() and bool(self.result.exception())


class RigWorker:
    """Shows patterns one after the other; whatever thread asks, one thread uses the rig.

    Parameters
    ----------
    rig : Rig, or callable that returns one
        A callable is called in the thread that uses the rig: windows and drivers may want that.
    leases : Leases
        A capture ends before its next pattern when its lease is no longer in force.
    kept : int
        Captures kept for requests that come again.

    Raises
    ------
    RfpipeError
        When the rig can't be opened.
    """

    def __init__(self, rig: Rig | Callable[[], Rig], leases: Leases, kept: int) -> None:
        self._leases = leases
        self._kept = kept
        self._captures: dict[str, _Capture] = {}
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._is_closed = False
        self._thread = ThreadPoolExecutor(1, "rig")
        self.metrics = Metrics()
        self.last: Shown | None = None
        try:
            self.rig: Rig = self._thread.submit(rig).result() if callable(rig) else rig
        except BaseException:
            self._thread.shutdown()
            raise

    def check_free(self, identity: str) -> None:
        """Raise RigBusyError where `submit` would, whatever the patterns are.

        Asked before anything of a request is read, or held in memory.
        """
        with self._lock:
            if identity not in self._captures:
                self._check_free()

    def again(self, identity: str, digest: str, lease: str) -> Future[bytes] | None:
        """Return the result of a request that came before and goes on, or is done; None if not.

        Raises
        ------
        CaptureConflictError
            When the identity was used with another content.
        """
        with self._lock:
            capture = self._captures.get(identity)
            if capture is None:
                return None
            if capture.digest != digest:
                raise CaptureConflictError(
                    "this Idempotency-Key was used with other patterns; take a new one"
                )
            capture.lease = lease
            if capture.has_failed:
                return None
            self.metrics.answered_again += 1
            return capture.result

    def submit(
        self, identity: str, digest: str, lease: str, patterns: SentPatterns
    ) -> Future[bytes]:
        """Have the patterns of a request exposed that isn't under way.

        Parameters
        ----------
        identity : str
            Of the request; the same when it comes again.
        digest : str
            Of its content.
        lease : str
        patterns : SentPatterns

        Returns
        -------
        Future
            Of the message with the brackets. Raises CaptureError, InputError or
            CaptureStoppedError; what was exposed until then is kept, and the same request goes on
            from there.

        Raises
        ------
        RigBusyError
            When another request's capture is under way.
        """
        with self._lock:
            self._check_free()
            capture = self._captures.get(identity)
            if capture is None:
                self._forget(self._kept - 1)
                capture = _Capture(digest, lease, Message({"keys": patterns.keys}))
                self._captures[identity] = capture
            capture.lease = lease
            capture.result = self._thread.submit(self._expose, capture, patterns)
            return capture.result

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
        """Wait for the exposure in hand and close the devices; closing twice is no error."""
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
        busy = [capture for capture in self._captures.values() if capture.is_under_way]
        # one that has lost its lease ends before its next pattern, and may be waited for by one
        if len(busy) >= 2 or any(self._leases.is_held_by(capture.lease) for capture in busy):
            raise RigBusyError("another capture is under way; send one at a time")

    def _forget(self, kept: int) -> None:
        """Forget all but the latest captures, and none that is under way."""
        done = [name for name, capture in self._captures.items() if not capture.is_under_way]
        for name in done[: max(0, len(done) - kept)]:
            del self._captures[name]

    def _expose(self, capture: _Capture, patterns: SentPatterns) -> bytes:
        """Expose the patterns that are missing: by sequences where the rig has them."""
        step = max(1, sequence_patterns(self.rig))
        for first in range(capture.exposed, len(patterns), step):
            if self.is_stopping:
                raise CaptureStoppedError("the server is being stopped; send it again")
            if not self._leases.is_held_by(capture.lease):
                raise CaptureStoppedError("the lease lapsed; send it again")
            last = min(first + step, len(patterns))
            keys = patterns.keys[first:last]
            began = time.perf_counter()
            brackets = self._taken(patterns.expanded(first, last), keys)
            self.metrics.exposing_seconds += time.perf_counter() - began
            self.metrics.brackets += last - first
            self.last = Shown(self.metrics.brackets, keys[-1], brackets[-1])
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
            self.metrics.last_error = f"pattern {keys[0]}: {error}"
            _log.exception("the rig failed at pattern %s", keys[0])
            if isinstance(error, CaptureError):
                raise
            raise CaptureError(f"the rig failed: {type(error).__name__}: {error}") from error
