"""Malformed and hostile requests: refused with a clear status, without effect on a capture."""

from __future__ import annotations

import io
import json
import socket
import struct
import threading
import time
import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import httpx
import numpy as np
import pytest
from tests.server.harness import RIGHT, TOKEN, Running, SlowRig, head_of_capture, running

from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig
from rfpipe.rigs.messages import MEDIA_TYPE, encode_patterns, pack_message

ON = np.ones((1, 3, 7), np.float32)
PATHS = ("/v1/status", "/v1/rig", "/v1/rig/arrays")
LIMITS = {"most_request_bytes": 100_000, "head_seconds": 1.0, "body_seconds": 1.5}


@pytest.fixture
def rig() -> SlowRig:
    return SlowRig(0.02, noise=CameraModel(), seed=1)


@pytest.fixture
def server(rig: SlowRig) -> Iterator[Running]:
    with running(rig, **LIMITS) as server:
        yield server


@contextmanager
def undisturbed_capture(server: Running, rig: SlowRig) -> Iterator[None]:
    """Capture all the while, as the holder of the rig; each pattern once, bytes as they must be."""
    patterns = np.random.default_rng(0).random((40, 3, 7), np.float32)
    keys = [(1, index) for index in range(40)]
    expected = OperatorRig.capture(rig, patterns, keys)
    frames: list[np.ndarray] = []
    first = threading.Event()

    def capture() -> None:
        with server.client() as client:
            for pattern, key in zip(patterns, keys, strict=True):
                frames.append(client.capture(pattern[None], [key])[0])
                first.set()

    thread = threading.Thread(target=capture)
    thread.start()
    assert first.wait(60)
    try:
        yield
    finally:
        thread.join(60)
    np.testing.assert_array_equal(np.array(frames), expected)
    assert rig.shown == keys


def connected(server: Running) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), timeout=60)


def status_of(connection: socket.socket) -> int:
    """Read an answer to its end; 0 where the connection was closed without one."""
    received = b""
    try:
        while chunk := connection.recv(65536):
            received += chunk
    except ConnectionResetError:
        pass
    return int(received.split()[1]) if received else 0


@pytest.mark.parametrize(
    "authorization",
    [
        None, "", "Bearer", "Bearer wrong", f"Basic {TOKEN}", TOKEN,
        f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", f"Bearer {TOKEN.upper()}",
        "Bearer " + "x" * 9000, b"Bearer \xff\xfe",
    ],
)  # fmt: skip
def test_missing_and_wrong_tokens_are_refused(
    server: Running, authorization: str | bytes | None
) -> None:
    headers: Any = {} if authorization is None else {"Authorization": authorization}
    with httpx.Client(base_url=server.url, trust_env=False) as http:
        for path in PATHS:
            answer = http.get(path, headers=headers)
            assert answer.status_code == 401
            assert answer.headers["www-authenticate"] == "Bearer"
            assert answer.json()["detail"].startswith("the bearer token is missing or wrong")
        for method in ("POST", "PUT", "DELETE"):
            assert http.request(method, "/v1/lease", headers=headers).status_code == 401
        body = encode_patterns(ON, [(1, 0)])
        assert http.post("/v1/captures", content=body, headers=headers).status_code == 401


@pytest.mark.parametrize(
    "path",
    [
        "/", "/v1", "/v1/", "/v2/rig", "/v1/rig/", "/v1/rig/arrays/../../../etc/passwd",
        "/../../etc/passwd", "/v1/%2e%2e/%2e%2e/etc/passwd", "//etc/passwd", "/v1/rig/..",
        "/v1/%00", "/docs", "/redoc", "/openapi.json", "/v1/health/../rig", "/v1/rig%0d%0aX: 1",
        "/" + "x" * 10_000,
    ],
)  # fmt: skip
def test_manipulated_paths_are_refused(server: Running, path: str) -> None:
    request = f"GET {path} HTTP/1.1\r\nHost: rig\r\nAuthorization: Bearer {TOKEN}\r\n"
    with connected(server) as connection:
        connection.sendall(request.encode() + b"Connection: close\r\n\r\n")
        status = status_of(connection)
    assert status in (400, 404)
    with connected(server) as connection:  # nor is the way round the token any shorter
        connection.sendall(
            f"GET {path} HTTP/1.1\r\nHost: rig\r\nConnection: close\r\n\r\n".encode()
        )
        assert status_of(connection) in (400, 401)


def post(server: Running, body: Any, **changes: str) -> httpx.Response:
    """Send a body as the holder of the rig."""
    with server.http() as http:
        lease = http.post("/v1/lease", json={"client": "attacker"}).json()["lease"]
        headers = {
            "Rig-Lease": lease,
            "Idempotency-Key": "an-attack-of-the-test",
            "Content-Type": MEDIA_TYPE,
            **changes,
        }
        try:
            return http.post("/v1/captures", content=body, headers=headers)
        finally:
            http.delete("/v1/lease", headers={"Rig-Lease": lease})


def message(patterns: np.ndarray, /, *, deflate: bool = False, **facts: Any) -> bytes:
    return pack_message({**KEYS, **facts}, {"patterns": patterns}, deflate=deflate)


KEYS: dict[str, Any] = {"keys": [[1, 0]]}


def npy(header: str | None = None, content: bytes = bytes(3), **changes: Any) -> bytes:
    """Return a .npy file of a pattern of 3 x 7 bits, with a modified header."""
    fields = {"descr": "|u1", "fortran_order": False, "shape": (1, 3), **changes}
    text = (header if header is not None else repr(fields)).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + content


def raw(
    facts: Any = None, array: bytes = npy(), how: int = zipfile.ZIP_STORED, **members: bytes
) -> bytes:
    """Return a message whose members may be anything."""
    text = facts if isinstance(facts, bytes) else json.dumps({**KEYS, **(facts or {})}).encode()
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", how) as archive:
        archive.writestr("facts.json", text)
        archive.writestr("patterns.npy", array)
        for name, content in members.items():
            archive.writestr(name, content)
    return buffer.getvalue()


def twice() -> bytes:
    buffer = io.BytesIO(raw())
    with zipfile.ZipFile(buffer, "a") as archive, pytest.warns(UserWarning, match="Duplicate name"):
        archive.writestr("patterns.npy", npy())
    return buffer.getvalue()


def crowd(entries: int) -> bytes:
    """Return a zip file that lists its one member many times, 46 bytes each."""
    entry = b"PK\x01\x02" + bytes(42)
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 65535, 65535, len(entry) * entries, 0, 0)
    return entry * entries + end


def harmed(content: bytes, old: bytes, new: bytes) -> bytes:
    assert old in content
    return content.replace(old, new)


MALFORMED = {
    "empty": b"",
    "no json": raw(b"{nope"),
    "deep json": raw(b"[" * 50_000),
    "long facts": raw(b" " * 2**20 + b"{}", how=zipfile.ZIP_DEFLATED),
    "no arrays": pack_message(KEYS, {}),
    "no array": raw(array=b"nothing"),
    "object dtype": raw(array=npy(descr="|O")),
    "code in the header": raw(array=npy("__import__('os').abort()")),
    "long header": raw(array=npy(" " * 5000)),
    "huge shape": raw(array=npy(shape=(2**39, 2**39))),
    "huge shape of nothing": raw(array=npy(shape=(0, 2**62), content=b"")),
    "many axes": raw(array=npy(shape=(1,) * 70, content=bytes(1))),
    "cut off": raw()[:-30],
    "more bytes": raw(array=npy(content=bytes(4))),
    "altered": harmed(message(np.full(ON.shape, 0.25, "<f4")), b"\0\0\x80>", b"\0\0\x81>"),
    "bomb": message(np.zeros((20, 1_000_000), np.uint8), deflate=True),
    "levels of too much": message(np.zeros((64, 30_000), np.uint8), deflate=True),
    "deflate of nothing": harmed(
        pack_message(KEYS, {"patterns": np.zeros((1, 3), np.uint8)}),
        b"\0\0\0\0!\0",
        b"\x08\0\0\0!\0",
    ),
    "by lzma": raw(how=zipfile.ZIP_LZMA),
    "two arrays": raw(**{"more.npy": npy()}),
    "one name twice": twice(),
    "other dtype": raw(array=npy(descr="|b1")),
    "keys of text": raw({"keys": [["a"]]}),
    "negative key": raw({"keys": [[-1, 0]]}),
    "too many": raw({"keys": [[1, 0]] * 1000}),
    "wrong shape": message(np.ones((1, 7, 3), np.float32)),
    "NaN": message(np.nan * ON),
    "negative": message(-ON),
    "above 1": message(1.5 * ON),
}


def test_malformed_messages_and_impossible_patterns_are_refused(
    server: Running, rig: SlowRig
) -> None:
    for name, body in MALFORMED.items():
        answer = post(server, body)
        assert answer.status_code == 422, (name, answer.text)
        assert answer.headers["content-type"] == "application/problem+json"
        assert len(answer.json()["detail"]) < 1000, name
    assert rig.shown == []


def test_wrong_headers_are_refused(server: Running, rig: SlowRig) -> None:
    body = encode_patterns(ON, [(1, 0)])
    assert post(server, body, **{"Content-Type": "application/json"}).status_code == 415
    for key in ("", "short", "x" * 100, "with spaces in the key", "../../../etc/passwd"):
        assert post(server, body, **{"Idempotency-Key": key}).status_code == 422
    assert post(server, body, **{"Rig-Lease": "another-lease-id"}).status_code == 410
    assert post(server, body, **{"Rig-Lease": "x"}).status_code == 422
    with server.http() as http:
        assert http.post("/v1/captures", content=body).status_code == 422
        for wrong in (None, [], "client", {"client": ""}, {"client": "x" * 101},
                      {"client": "a\x00"}, {"client": 1}, {"client": "a", "more": 1}):  # fmt: skip
            assert http.post("/v1/lease", json=wrong).status_code == 422
    assert rig.shown == []


def test_oversized_bodies_are_refused(server: Running, rig: SlowRig) -> None:
    with undisturbed_capture(server, rig), server.http() as http:
        large = bytes(200_000)
        headers = {"Rig-Lease": "some-lease", "Idempotency-Key": "x" * 20}
        assert http.post("/v1/captures", content=large, headers=headers).status_code == 413
        assert http.post("/v1/lease", content=bytes(5000)).status_code == 413
        chunked = http.post("/v1/lease", content=(bytes(1000) for _ in range(10)))
        assert chunked.status_code == 411
        for declared in (b"99999999999999999999", b"100001"):
            with connected(server) as connection:
                connection.sendall(
                    b"POST /v1/captures HTTP/1.1\r\nHost: rig\r\nContent-Type: text/plain\r\n"
                    b"Authorization: " + RIGHT["Authorization"].encode() + b"\r\n"
                    b"Content-Length: " + declared + b"\r\n\r\n"
                )
                assert status_of(connection) == 413  # before any of it is read
        refused = httpx.post(f"{server.url}/v1/captures", content=large, trust_env=False)
        assert refused.status_code == 401


def test_slow_clients_are_disconnected(server: Running, rig: SlowRig) -> None:
    with undisturbed_capture(server, rig), ExitStack() as stack:
        slow = [stack.enter_context(connected(server)) for _ in range(2)]
        slow[1].sendall(b"GET /v1/rig HTTP/1.1\r\nHost: r")
        assert [status_of(connection) for connection in slow] == [0, 0]
        dripping = stack.enter_context(connected(server))
        began = time.monotonic()
        try:
            for byte in b"GET /v1/rig HTTP/1.1\r\n" + b"X: y\r\n" * 100:
                dripping.sendall(bytes([byte]))
                time.sleep(0.02)
        except OSError:
            pass
        assert (
            time.monotonic() - began < 10
        )  # the request takes twelve: a byte does not restart the limit
    assert server.worker.leases.holder is None


@pytest.mark.parametrize("beginning", [b"", b"PK"])
def test_a_missing_body_does_not_block_the_server(server: Running, beginning: bytes) -> None:
    with server.http() as http, connected(server) as connection:
        lease = http.post("/v1/lease", json={"client": "slow"}).json()["lease"]
        headers = {"Rig-Lease": lease, "Idempotency-Key": "x" * 20, "Content-Type": MEDIA_TYPE}
        connection.sendall(head_of_capture(headers, 20) + beginning)
        assert status_of(connection) == 408


def test_more_connections_than_allowed_are_refused_and_the_holder_is_not(rig: SlowRig) -> None:
    with (
        running(rig, **LIMITS, most_connections=20) as server,
        undisturbed_capture(server, rig),
        ExitStack() as stack,
    ):
        crowd = [stack.enter_context(connected(server)) for _ in range(60)]
        statuses = [status_of(connection) for connection in crowd]
        assert set(statuses) == {0}
