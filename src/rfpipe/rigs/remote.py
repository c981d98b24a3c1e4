"""A rig behind an acquisition server, anywhere on the network."""

from __future__ import annotations

import logging
import secrets
import socket
import threading
import time
from collections.abc import Sequence
from os import getpid
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.config.addresses import check_server
from rfpipe.errors import CaptureError, InputError, TransferError
from rfpipe.installation import needing
from rfpipe.photometry import Sensor, sensor_from_description
from rfpipe.rigs.base import Key, check_patterns
from rfpipe.rigs.devices import Closing
from rfpipe.rigs.messages import (
    API,
    MEDIA_TYPE,
    LeaseAnswer,
    RigAnswer,
    StatusAnswer,
    encode_patterns,
    unpack_message,
)

if TYPE_CHECKING:
    import httpx


_log = logging.getLogger(__name__)

_LAPSED = "%s: the lease expired, or the server was restarted; acquiring a new lease"


class RemoteRig(Closing):
    """Client of `rfpipe.server`: a rig whose devices belong to another process or machine.

    The first capture acquires the rig; a heartbeat in the background keeps it until `close`. If the
    server doesn't answer, or another client holds the rig, the client waits. After a restart of the
    server, a capture continues.

    Parameters
    ----------
    url : str
        Address such as ``http://127.0.0.1:8750``.
    token : str
        The server's bearer token.
    patience_seconds : float
        Longest wait for a server that doesn't answer, for another client, or for a rig that fails;
        at least 0.

    Raises
    ------
    CaptureError
        When the server doesn't answer in that time, refuses the token or has another API version.
    InputError
        When the URL isn't an ``http`` or ``https`` address.
    """

    def __init__(self, url: str, token: str, patience_seconds: float = 600.0) -> None:
        self.url = url
        self._connection = _Connection(url, token, patience_seconds)
        self._heart: _HeartBeat | None = None
        try:
            self._rig = self._described()
            self.sensor: Sensor = self._sensor()
        except BaseException:
            self._connection.close()
            raise
        self.camera_shape, self.projector_shape = self._rig.camera_shape, self._rig.projector_shape
        self.channels = self._rig.channels
        self.seconds_per_pattern = self._rig.seconds_per_pattern
        self._frame_shape = self.sensor.frame_shape(self.camera_shape, self.channels)
        in_ten_seconds = int(10 // max(self.seconds_per_pattern, 1e-3))
        self._at_a_time = max(1, min(self._rig.limits.patterns, in_ten_seconds))

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns and return their brackets; see `rfpipe.rigs.Rig.capture`.

        CaptureError also when the server doesn't answer, another client holds the rig or the rig
        fails, for longer than `patience_seconds`, or when the rig's description changed.
        """
        patterns = check_patterns(patterns, keys, self.projector_shape)
        frames = np.empty((len(patterns), *self._frame_shape), self.sensor.frame_dtype)
        for first in range(0, len(patterns), self._at_a_time):
            part = slice(first, first + self._at_a_time)
            frames[part] = self._request(patterns[part], keys[part])
        return frames

    def describe(self) -> dict[str, Any]:
        """Description of the server's rig; the address doesn't affect a frame."""
        return self._rig.description

    @property
    def statistics(self) -> dict[str, dict[str, int]]:
        """Counters of the server's devices since its start."""
        answer = self._connection.send("GET", "/v1/status")
        return StatusAnswer.model_validate_json(answer.content).devices

    def close(self) -> None:
        """Release the rig for other clients; further calls have no effect."""
        self._release()
        self._connection.close()

    def _request(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Capture patterns by one request, which is repeated until a complete answer arrives."""
        body = encode_patterns(patterns, keys)
        half = len(patterns) // 2
        if half and len(body) > self._rig.limits.request_bytes:
            parts = (slice(0, half), slice(half, None))
            return np.concatenate([self._request(patterns[part], keys[part]) for part in parts])
        headers = {
            "Content-Type": MEDIA_TYPE,
            # identifies repetitions of the request, so that the server exposes nothing twice
            "Idempotency-Key": secrets.token_urlsafe(24),
        }
        seconds = self.seconds_per_pattern * len(patterns)
        patience = self._connection.patience()
        while True:
            headers["Rig-Lease"] = self._lease()
            try:
                response = self._connection.send(
                    "POST", "/v1/captures", seconds, content=body, headers=headers
                )
                brackets = self._brackets(response.content, keys)
            except TransferError as error:
                patience.pause(f"its answer is damaged ({error})")
            except _RefusedError as refusal:
                if refusal.status == 410:
                    _log.warning(_LAPSED, self.url)
                    self._release()
                elif refusal.status == 502:
                    patience.pause(f"the rig failed: {refusal.detail}")
                else:
                    raise
            else:
                patience.end("the rig works again; continuing")
                return brackets

    def _brackets(self, answer: bytes, keys: Sequence[Key]) -> NDArray[Any]:
        """Read the brackets of an answer; TransferError if it is damaged."""
        frames = np.empty((len(keys), *self._frame_shape), self.sensor.frame_dtype)
        facts, arrays = unpack_message(answer, frames.nbytes)
        if facts.get("keys") != [list(map(int, key)) for key in keys]:
            raise TransferError("its brackets have the keys of other patterns")
        for index, frame in enumerate(frames):
            bracket = arrays.get(str(index))
            if bracket is None or bracket.shape != frame.shape or bracket.dtype != frame.dtype:
                form = "none" if bracket is None else f"{bracket.dtype} {bracket.shape}"
                raise TransferError(
                    f"bracket {index} is {form}; expected {frame.dtype} {frame.shape}"
                )
            frame[...] = bracket
        return frames

    def _lease(self) -> str:
        """Identifier of the lease; acquires the rig if necessary."""
        if self._heart is not None and not self._heart.is_alive():
            _log.warning(_LAPSED, self.url)
            self._release()
        if self._heart is None:
            client = f"{socket.gethostname()}:{getpid()}"  # for the server's log
            answer = self._connection.send("POST", "/v1/lease", json={"client": client})
            self._heart = _HeartBeat(
                self._connection, LeaseAnswer.model_validate_json(answer.content)
            )
            if self._described().digest != self._rig.digest:
                raise CaptureError(
                    f"{self.url}: the server's rig or its settings changed since this capture "
                    "began",
                    remedy="Restart the server with the previous settings, or run the capture "
                    "again",
                )
        return self._heart.lease

    def _release(self) -> None:
        heart, self._heart = self._heart, None
        if heart is not None:
            heart.stop()

    def _described(self) -> RigAnswer:
        """Read the server's description of the rig, after a check of the API version."""
        api = self._connection.send("GET", "/v1/health").json().get("api")
        if api != API:
            raise CaptureError(
                f"{self.url}: has version {api} of the API; this rfpipe has version {API}",
                remedy="Run the same version of rfpipe on both sides",
            )
        return RigAnswer.model_validate_json(self._connection.send("GET", "/v1/rig").content)

    def _sensor(self) -> Sensor:
        arrays = None
        if self._rig.has_arrays:
            _, arrays = unpack_message(
                self._connection.send("GET", "/v1/rig/arrays").content, 2**34
            )
        try:
            return sensor_from_description(self._rig.sensor, arrays)
        except InputError as error:
            raise CaptureError(
                f"{self.url}: {error}", remedy="Run the same version of rfpipe on both sides"
            ) from error


class _RefusedError(CaptureError):
    """Error in the server's answer that can't be resolved by waiting."""

    def __init__(self, url: str, status: int, detail: str) -> None:
        super().__init__(f"{url}: the server refused with status {status}: {detail}")
        self.status, self.detail = status, detail


class _Connection:
    """HTTP connection to a server that may be temporarily unavailable; thread-safe."""

    def __init__(self, url: str, token: str, patience_seconds: float) -> None:
        with needing("rig", "a remote rig"):
            import httpx
        try:
            check_server(url)
        except ValueError as error:
            raise InputError(f"url is {url!r}; it should {error}") from None
        if not 0 <= patience_seconds < float("inf"):
            raise InputError(f"patience_seconds is {patience_seconds}; expected at least 0")
        self._url = url.rstrip("/")
        self._patience_seconds = patience_seconds
        self._http = httpx.Client(
            base_url=self._url,
            headers={"Authorization": f"Bearer {token}"},
            # the second connection is for heartbeats
            limits=httpx.Limits(max_connections=2, keepalive_expiry=60.0),
            verify=url.startswith("https"),  # plain HTTP needs no certificates
            trust_env=False,  # don't use a web proxy
        )
        self._closing = threading.Event()
        self._waiting = self.patience()

    def patience(self) -> _Patience:
        """Create a patience of the same duration, for failures of the rig behind the server."""
        return _Patience(self._url, self._patience_seconds, self._closing)

    def send(self, method: str, path: str, seconds: float = 0.0, **request: Any) -> httpx.Response:
        """Send a request, repeatedly if necessary, and return the answer.

        `seconds` is the expected duration of the capture. _RefusedError when the answer is an error
        status; CaptureError when the server doesn't answer, or another client holds the rig, for
        longer than the patience.
        """
        import httpx

        while True:
            try:
                response = self.try_once(method, path, seconds, **request)
            except httpx.TransportError as error:
                self._waiting.pause(
                    f"no answer ({type(error).__name__}: {error}); check that 'rfpipe serve' is "
                    "running on that machine, and the network"
                )
                continue
            if response.status_code not in (408, 409, 429, 503):
                break
            self._waiting.pause(_detail(response))
        self._waiting.end("answers again; continuing")
        if response.is_success:
            return response
        detail = _detail(response)
        if response.status_code == 401:
            detail += "; see capture.token_file, or the environment variable with the token"
        raise _RefusedError(self._url, response.status_code, detail)

    def try_once(
        self, method: str, path: str, seconds: float = 0.0, **request: Any
    ) -> httpx.Response:
        """Send a request and return the answer; httpx.TransportError without an answer."""
        import httpx

        # a bracket may take several times as long, by retries or a device that reconnects
        timeout = httpx.Timeout(30.0 + 4.0 * seconds, connect=5.0)
        return self._http.request(method, path, timeout=timeout, **request)

    def close(self) -> None:
        """Close the connection; further calls have no effect."""
        self._closing.set()
        self._http.close()


def _detail(response: httpx.Response) -> str:
    """Extract the description from the answer of an error."""
    try:
        detail = response.json()["detail"]
    except (ValueError, KeyError, TypeError):
        detail = response.text[:200]
    return f"{detail} (status {response.status_code})"


class _HeartBeat(threading.Thread):
    """Thread that renews a lease until it is stopped, then releases it; ends if it expired."""

    def __init__(self, connection: _Connection, answer: LeaseAnswer) -> None:
        super().__init__(name="heartbeat", daemon=True)
        self.lease = answer.lease
        self._connection = connection
        self._interval = answer.seconds / 4
        self._stopping = threading.Event()
        self.start()

    def stop(self) -> None:
        """Stop, and release the lease if it is still valid."""
        self._stopping.set()
        self.join()

    def run(self) -> None:
        """Renew the lease; failures of the connection are reported by the capture."""
        import httpx

        headers = {"Rig-Lease": self.lease}
        while not self._stopping.wait(self._interval):
            try:
                answer = self._connection.try_once("PUT", "/v1/lease", headers=headers)
            except httpx.TransportError:
                continue
            if answer.status_code == 410:
                return
        try:
            self._connection.try_once("DELETE", "/v1/lease", headers=headers)
        except httpx.TransportError as error:
            _log.info("the lease was not released (%s); it will expire", error)


class _Patience:
    """Waits with increasing duration between attempts, up to a total time."""

    def __init__(self, name: str, seconds: float, closing: threading.Event) -> None:
        self._name, self._seconds, self._closing = name, seconds, closing
        self._since: float | None = None

    def end(self, news: str) -> None:
        """Reset after a success; log `news` if attempts had failed."""
        if self._since is not None:
            _log.warning("%s: %s", self._name, news)
            self._since = None

    def pause(self, reason: str) -> None:
        """Wait before the next attempt; CaptureError when the total time is over.

        The message contains the reasons of the first and the last failure.
        """
        if self._since is None:
            self._since, self._pause, self._first = time.monotonic(), 0.1, reason
            _log.warning("%s: %s; waiting for up to %g s", self._name, reason, self._seconds)
        waited = time.monotonic() - self._since
        if waited >= self._seconds:
            raise CaptureError(
                f"{self._name}: {self._first}. Last failure: {reason}. Waited for {waited:.0f} s "
                "(capture.patience_seconds); captured brackets are kept: run again after solving "
                "the problem"
            )
        self._closing.wait(min(self._pause, self._seconds - waited))
        self._pause = min(2 * self._pause, 5.0)
