"""A rig behind an acquisition server, anywhere on the network."""

from __future__ import annotations

import logging
import secrets
import socket
from collections.abc import Sequence
from os import getpid
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError, TransferError
from rfpipe.photometry import Sensor, sensor_from_description
from rfpipe.rigs.base import Key, check_patterns
from rfpipe.rigs.connection import Connection, RefusedError
from rfpipe.rigs.devices import Closing
from rfpipe.rigs.heartbeat import HeartBeat
from rfpipe.rigs.messages import MEDIA_TYPE, unpack
from rfpipe.rigs.wire import encode_patterns

if TYPE_CHECKING:
    import httpx

__all__ = ["RemoteRig"]

Float = NDArray[np.float32]

_API = 1
_MOST_ARRAY_BYTES = 2**34
_SECONDS_PER_REQUEST = 10.0

_log = logging.getLogger(__name__)


class RemoteRig(Closing):
    """The client of `rfpipe.server`: a rig whose devices another process or machine has.

    The first capture takes the rig; a heart-beat in the background keeps it until `close`. A server
    that doesn't answer, or that another client holds, is waited for. After a restart of the server
    a capture goes on where it was.

    Parameters
    ----------
    url : str
        Such as ``http://127.0.0.1:8750``.
    token : str
        The server's bearer token.
    patience_seconds : float
        How long to wait for a server that doesn't answer, for another client to end, or for a rig
        that fails, at least 0.
    client : str, optional
        A name for the server's log; this machine and process by default.

    Raises
    ------
    CaptureError
        When the server doesn't answer in that time, refuses the token or speaks another version.
    InputError
        When the URL is none of ``http`` or ``https``.
    """

    def __init__(
        self, url: str, token: str, patience_seconds: float = 600.0, client: str | None = None
    ) -> None:
        self.url = url
        self._client = client or f"{socket.gethostname()}:{getpid()}"
        self._connection = Connection(url, token, patience_seconds)
        self._heart: HeartBeat | None = None
        try:
            self._described = self._described_by_server()
            self.camera_shape: tuple[int, ...] = tuple(self._described["camera_shape"])
            self.projector_shape: tuple[int, ...] = tuple(self._described["projector_shape"])
            self.channels: int = self._described["channels"]
            self.seconds_per_pattern: float = self._described["seconds_per_pattern"]
            self.sensor: Sensor = self._sensor()
        except BaseException:
            self._connection.close()
            raise
        self._frame_shape = self.sensor.frame_shape(self.camera_shape, self.channels)
        in_time = int(_SECONDS_PER_REQUEST // max(self.seconds_per_pattern, 1e-3))
        self._at_a_time = max(1, min(self._described["limits"]["patterns"], in_time))

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Show patterns and return their brackets; see `rfpipe.rigs.Rig.capture`.

        Raises
        ------
        CaptureError
            Also when the server doesn't answer, is held by another client or its rig fails, for
            longer than `patience_seconds`, or it serves another rig than before.
        """
        patterns = check_patterns(patterns, keys, self.projector_shape)
        frames = np.empty((len(patterns), *self._frame_shape), self.sensor.frame_dtype)
        for first in range(0, len(patterns), self._at_a_time):
            last = min(first + self._at_a_time, len(patterns))
            frames[first:last] = self._request(patterns[first:last], keys[first:last])
        return frames

    def describe(self) -> dict[str, Any]:
        """Return the description of the rig behind the server; where it is shapes no frame."""
        description: dict[str, Any] = self._described["description"]
        return description

    @property
    def statistics(self) -> dict[str, dict[str, int]]:
        """What the devices behind the server counted since its start."""
        found: dict[str, dict[str, int]] = (
            self._connection.send("GET", "/v1/status").json().get("devices", {})
        )
        return found

    def close(self) -> None:
        """Give the rig back to other clients; closing twice is no error."""
        if self._heart is not None:
            self._heart.stop()
            self._heart = None
        self._connection.close()

    def _request(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Have patterns shown by one request, sent again until its answer arrives whole."""
        body = encode_patterns(patterns, keys)
        half = len(patterns) // 2
        if half and len(body) > self._described["limits"]["request_bytes"]:
            parts = (slice(0, half), slice(half, None))
            return np.concatenate([self._request(patterns[part], keys[part]) for part in parts])
        headers = {
            "Content-Type": MEDIA_TYPE,
            # the server knows the request by it, and exposes nothing twice
            "Idempotency-Key": secrets.token_urlsafe(24),
        }
        seconds = self.seconds_per_pattern * len(patterns)
        rig = self._connection.patience()
        while True:
            lease = {"Rig-Lease": self._lease()}
            try:
                response = self._connection.send(
                    "POST", "/v1/captures", seconds, content=body, headers=headers | lease
                )
                brackets = self._brackets(response, keys)
            except TransferError as error:
                rig.pause(f"its answer arrived damaged ({error})")
            except RefusedError as refusal:
                if refusal.status == 410:
                    self._lose_lease()
                    continue
                if refusal.status != 502:
                    raise
                rig.pause(f"the rig failed: {refusal.detail}")
            else:
                if rig.is_tried:
                    _log.warning("%s: the rig works again; going on", self.url)
                return brackets

    def _brackets(self, response: httpx.Response, keys: Sequence[Key]) -> NDArray[Any]:
        """Return the brackets of an answer; raises TransferError where it is damaged."""
        expected = (len(keys), *self._frame_shape)
        dtype = self.sensor.frame_dtype
        size = int(np.prod(expected)) * dtype.itemsize
        facts, arrays = unpack(response.content, size)
        brackets = [arrays.get(str(index)) for index in range(len(keys))]
        if facts.get("keys") != [list(map(int, key)) for key in keys]:
            raise TransferError("it answers for other patterns")
        frames = np.empty(expected, dtype)
        for index, bracket in enumerate(brackets):
            if bracket is None or bracket.shape != expected[1:] or bracket.dtype != dtype:
                form = "none" if bracket is None else f"{bracket.dtype} {bracket.shape}"
                raise TransferError(f"bracket {index} is {form}; expected {dtype} {expected[1:]}")
            frames[index] = bracket
        return frames

    def _lease(self) -> str:
        """Return the lease's id, the rig taken if it isn't yet."""
        if self._heart is None or self._heart.has_stopped:
            if self._heart is not None:
                self._lose_lease()
            answer = self._connection.send("POST", "/v1/lease", json={"client": self._client})
            lease = answer.json()
            try:
                self._check_same_rig()
            finally:
                self._heart = HeartBeat(
                    self._connection.another(), lease["lease"], lease["seconds"]
                )
        return self._heart.lease

    def _lose_lease(self) -> None:
        _log.warning("%s: the lease lapsed, or the server was restarted; taking it anew", self.url)
        if self._heart is not None:
            self._heart.stop()
            self._heart = None

    def _check_same_rig(self) -> None:
        if self._described_by_server()["digest"] != self._described["digest"]:
            raise CaptureError(
                f"{self.url}: the server serves another rig, or with other settings, than when "
                "this capture began. Start it with the settings of then, or run again to begin "
                "anew"
            )

    def _described_by_server(self) -> dict[str, Any]:
        health = self._connection.send("GET", "/v1/health").json()
        if health.get("api") != _API:
            raise CaptureError(
                f"{self.url}: speaks version {health.get('api')} of the interface; this rfpipe "
                f"speaks {_API}. Run the same rfpipe on both sides"
            )
        described: dict[str, Any] = self._connection.send("GET", "/v1/rig").json()
        return described

    def _sensor(self) -> Sensor:
        arrays = None
        if self._described["has_arrays"]:
            answer = self._connection.send("GET", "/v1/rig/arrays")
            _, arrays = unpack(answer.content, _MOST_ARRAY_BYTES)
        try:
            return sensor_from_description(self._described["sensor"], arrays)
        except InputError as error:
            raise CaptureError(f"{self.url}: {error}. Run the same rfpipe on both sides") from error
