"""A real server on a real port, in a thread of the test's process."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
from scipy.sparse import csr_array

from rfpipe.photometry import CameraModel, ResampledSensor, Resampling
from rfpipe.rigs import OperatorRig, RemoteRig, Rig
from rfpipe.server import ServerSettings
from rfpipe.server.run import bound_socket, make_server

TOKEN = "a-token-for-tests-only"
RIGHT = {"Authorization": f"Bearer {TOKEN}"}


@dataclass
class Running:
    """A server that runs."""

    url: str
    port: int
    app: Any

    @property
    def worker(self) -> Any:
        return self.app.state.served.worker

    def client(self, patience_seconds: float = 20.0) -> RemoteRig:
        return RemoteRig(self.url, TOKEN, patience_seconds)

    def http(self) -> httpx.Client:
        return httpx.Client(base_url=self.url, headers=RIGHT, trust_env=False, timeout=60)


@contextmanager
def running(rig: Rig | Callable[[], Rig], **settings: Any) -> Iterator[Running]:
    """Serve a rig until the end of the block."""
    allowed = ServerSettings(**{"port": 0, "lease_seconds": 4.0, **settings})
    with bound_socket(allowed.host, allowed.port) as bound:
        port = bound.getsockname()[1]
        server = make_server(rig, TOKEN, allowed)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [bound]})
        thread.start()
        try:
            while not server.started and thread.is_alive():
                time.sleep(0.005)
            yield Running(f"http://127.0.0.1:{port}", port, server.config.app)
        finally:
            server.should_exit = True
            thread.join(120)
            assert not thread.is_alive()


def head_of_capture(headers: dict[str, str], size: int) -> bytes:
    """Return the head of a capture request whose content has `size` bytes."""
    lines = {"Host": "rig", "Content-Length": size, **RIGHT, **headers}
    head = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    return f"POST /v1/captures HTTP/1.1\r\n{head}\r\n".encode()


@contextmanager
def posted(server: Running, rig: SlowRig, body: bytes, headers: dict[str, str]) -> Iterator[None]:
    """Send a capture, go on when its exposure began, and hang up without having read the answer."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=60) as connection:
        connection.sendall(head_of_capture(headers, len(body)) + body)
        assert rig.began.wait(60)
        yield


def transport(rows: int, columns: int) -> np.ndarray:
    """Diagonal light and a dim rest, in radiance that a camera can take."""
    random = np.random.default_rng(0)
    matrix = random.uniform(0, 0.2 / columns, (3, rows, columns))
    matrix += np.eye(rows, columns) * random.uniform(0.2, 1, (3, 1, columns))
    return matrix


class SlowRig(OperatorRig):
    """Counts its exposures and takes its time for them, or waits in them while `go_on` is clear."""

    def __init__(self, seconds: float = 0.0, **options: Any) -> None:
        super().__init__(transport(20, 21), (4, 5), (3, 7), **options)
        self.seconds = seconds
        self.began, self.go_on = threading.Event(), threading.Event()
        self.go_on.set()
        self.shown: list[tuple[int, ...]] = []
        self.closed = 0
        self.faults: dict[tuple[int, ...], list[Exception]] = {}

    def capture(self, patterns: np.ndarray, keys: Any) -> np.ndarray:
        self.began.set()
        time.sleep(self.seconds * len(keys))
        assert self.go_on.wait(60)
        if faults := self.faults.get(tuple(keys[0])):
            raise faults.pop(0)
        self.shown.extend(map(tuple, keys))
        return super().capture(patterns, keys)

    def close(self) -> None:
        self.closed += 1


class ResampledRig:
    """A rig whose camera has twice as many pixels as there are rays, each ray the mean of two."""

    camera_shape = projector_shape = (4, 5)
    channels = 3
    seconds_per_pattern = 0.0

    def __init__(self) -> None:
        camera = CameraModel()
        matrix = np.repeat(transport(20, 20), 2, axis=1)
        shares = csr_array(np.repeat(np.eye(20, dtype=np.float32), 2, axis=1) / 2)
        self.raw = OperatorRig(matrix, (4, 10), (4, 5), noise=camera)
        self.sensor = ResampledSensor(camera, Resampling((4, 5), (4, 10), shares))

    def capture(self, patterns: np.ndarray, keys: Any) -> np.ndarray:
        return self.raw.capture(patterns, keys)

    def describe(self) -> dict[str, Any]:
        return {**self.raw.describe(), "sensor": self.sensor.describe()}
