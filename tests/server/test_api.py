"""The server's endpoints over a real HTTP connection, and its client when things go wrong."""

from __future__ import annotations

import logging
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import httpx
import numpy as np
import pytest
from tests.server.harness import RIGHT, TOKEN, Running, SlowRig, posted, running
from tests.services.ports import free_port
from tests.services.waiting import wait_until

import rfpipe
from rfpipe.errors import CaptureError, ConfigError
from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig, RemoteRig
from rfpipe.rigs.messages import MEDIA_TYPE, encode_patterns
from rfpipe.server.run import bound_socket

ON = np.ones((1, 3, 7), np.float32)


@pytest.fixture
def rig() -> SlowRig:
    return SlowRig(noise=CameraModel(), seed=1)


@pytest.fixture
def server(rig: SlowRig) -> Iterator[Running]:
    with running(rig) as server:
        yield server


@pytest.fixture
def http(server: Running) -> Iterator[httpx.Client]:
    with server.http() as client:
        yield client


def lease_of(http: httpx.Client) -> str:
    return str(http.post("/v1/lease", json={"client": "test"}).json()["lease"])


def headers_of(lease: str, key: str = "a-key-of-the-test") -> dict[str, str]:
    return {"Rig-Lease": lease, "Idempotency-Key": key, "Content-Type": MEDIA_TYPE}


def test_health_needs_no_token_and_reveals_nothing_about_the_rig(server: Running) -> None:
    answer = httpx.get(f"{server.url}/v1/health", trust_env=False)
    assert answer.json() == {"status": "ok", "version": rfpipe.__version__, "api": 1}
    assert answer.headers["cache-control"] == "no-store"


def test_a_repeated_request_is_not_exposed_again(http: httpx.Client, rig: SlowRig) -> None:
    headers, body = headers_of(lease_of(http)), encode_patterns(ON, [(1, 5)])
    first, repeated = (http.post("/v1/captures", content=body, headers=headers) for _ in range(2))
    assert first.status_code == repeated.status_code == 200
    assert first.content == repeated.content
    assert rig.shown == [(1, 5)]
    encoded = encode_patterns(0 * ON, [(1, 5)])
    answer = http.post("/v1/captures", content=encoded, headers=headers)
    assert answer.status_code == 422
    assert "used with other patterns" in answer.json()["detail"]


def test_heartbeats_are_sent_between_captures(rig: SlowRig) -> None:
    with running(rig, lease_seconds=2.5) as server, server.client() as client:
        client.capture(ON, [(1, 0)])
        time.sleep(3.0)
        with server.http() as second:
            assert second.post("/v1/lease", json={"client": "another"}).status_code == 409
        client.capture(ON, [(1, 1)])
    assert rig.shown == [(1, 0), (1, 1)]
    assert rig.closed == 1


def test_a_second_client_waits_for_the_first_and_logs_it(
    server: Running, rig: SlowRig, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = server.client(), server.client()
    first.capture(ON, [(1, 0)])

    def close_once_said() -> None:
        wait_until(lambda: "the rig is held by" in caplog.text, "the wait")
        first.close()

    release = threading.Thread(target=close_once_said)
    with second, caplog.at_level(logging.WARNING):
        release.start()
        second.capture(ON, [(1, 1)])
    release.join()
    assert rig.shown == [(1, 0), (1, 1)]


def test_the_capture_of_a_client_that_died_ends_before_the_next_pattern(
    rig: SlowRig,
) -> None:
    rig.seconds = 0.2
    with running(rig, lease_seconds=0.5) as server, server.http() as http:
        headers = headers_of(lease_of(http))
        encoded = encode_patterns(np.repeat(ON, 20, axis=0), [(1, i) for i in range(20)])
        with posted(server, rig, encoded, headers):
            pass
        with server.client() as next_one:
            next_one.capture(ON, [(2, 0)])
        assert rig.shown[-1] == (2, 0)
        assert 1 < len(rig.shown) < 10


def test_a_failing_rig_is_retried_a_limited_number_of_times(
    server: Running, rig: SlowRig, caplog: pytest.LogCaptureFixture
) -> None:
    with server.client(patience_seconds=1.5) as client:
        rig.faults = {(1, 0): [CaptureError("the lamp flickers"), OSError("USB")]}
        client.capture(ON, [(1, 0)])
        rig.faults = {(1, 1): [CaptureError(f"no light {i}") for i in range(1000)]}
        began = time.monotonic()
        expected = r"the rig failed: no light 0 .*Last failure: .*no light [1-9].*run again"
        with pytest.raises(CaptureError, match=expected):
            client.capture(ON, [(1, 1)])
        assert time.monotonic() - began >= 1.5  # as it said
        rig.faults = {}
        client.capture(ON, [(1, 1)])
    assert rig.shown == [(1, 0), (1, 1)]
    assert "the lamp flickers" in caplog.text
    assert "waiting for up to 1.5 s" in caplog.text
    with server.http() as http:
        status = http.get("/v1/status").json()
    assert status["failures"] >= 5
    assert "no light" in status["last_error"]


class SequenceRig(SlowRig):
    """One that shows up to two patterns in hardware."""

    sequence_patterns = 2
    lists: list[int]

    def show_sequence(self, patterns: np.ndarray, keys: list[tuple[int, ...]]) -> np.ndarray:
        self.lists.append(len(keys))
        return OperatorRig.capture(self, patterns, keys)


def test_a_rig_with_sequences_shows_them() -> None:
    rig = SequenceRig(noise=CameraModel(), seed=1)
    rig.lists = []
    patterns, keys = np.repeat(ON, 5, axis=0), [(1, index) for index in range(5)]
    with running(rig) as server, server.client() as client:
        frames = client.capture(patterns, keys)
        with server.http() as http:
            assert http.get("/v1/status").json()["brackets"] == 5
    np.testing.assert_array_equal(frames, OperatorRig.capture(rig, patterns, keys))
    assert rig.lists == [2, 2]
    assert rig.shown == [(1, 4)]


def test_a_failed_request_continues(server: Running, rig: SlowRig) -> None:
    patterns, keys = np.repeat(ON, 3, axis=0), [(1, index) for index in range(3)]
    rig.faults = {(1, 1): [CaptureError("once")]}
    with server.client() as client:
        frames = client.capture(patterns, keys)
    assert rig.shown == keys
    np.testing.assert_array_equal(frames, OperatorRig.capture(rig, patterns, keys))


def test_a_client_waits_for_a_restart_and_repeats_its_request(
    caplog: pytest.LogCaptureFixture,
) -> None:
    port = free_port()
    first = SlowRig(noise=CameraModel(), seed=1)
    with running(first, port=port) as server:
        client = server.client()
        before = client.capture(ON, [(1, 0)])
    second = SlowRig(noise=CameraModel(), seed=1)

    def restart() -> None:
        with running(second, port=port):
            stopped.wait(120)

    stopped = threading.Event()
    thread = threading.Timer(0.5, restart)
    thread.start()
    try:
        with client, caplog.at_level(logging.WARNING):
            np.testing.assert_array_equal(client.capture(ON, [(1, 0)]), before)
    finally:
        stopped.set()
        thread.join()
    assert second.shown == [(1, 0)]
    assert "check that 'rfpipe serve' is running" in caplog.text


def test_another_rig_after_a_restart_is_refused() -> None:
    port = free_port()
    with running(SlowRig(seed=1), port=port) as server:
        client = server.client()
        client.capture(ON, [(1, 0)])
    with (
        running(SlowRig(seed=2), port=port),
        client,
        pytest.raises(CaptureError, match="rig or its settings changed"),
    ):
        client.capture(ON, [(1, 0)])


def test_a_client_gives_up_without_a_server() -> None:
    with pytest.raises(CaptureError, match=r"no answer .*check that 'rfpipe serve' is running"):
        RemoteRig(f"http://127.0.0.1:{free_port()}", TOKEN, patience_seconds=0.3)


def test_a_wrong_token_is_named_at_once(server: Running) -> None:
    with pytest.raises(CaptureError, match=r"token is missing or wrong.*capture\.token_file"):
        RemoteRig(server.url, "another-token-entirely", patience_seconds=60)


def test_a_damaged_answer_is_requested_again(
    server: Running, rig: SlowRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    send = httpx.Client.request
    harmed = []

    def through_a_bad_cable(self: httpx.Client, method: str, url: str, **options: Any) -> Any:
        answer = send(self, method, url, **options)
        if url == "/v1/captures" and not harmed:
            harmed.append(url)
            middle = len(answer.content) // 2
            damaged = bytearray(answer.content)
            damaged[middle] ^= 1
            answer._content = bytes(damaged)
        return answer

    monkeypatch.setattr(httpx.Client, "request", through_a_bad_cable)
    with server.client() as client:
        frames = client.capture(ON, [(1, 0)])
    assert harmed
    assert rig.shown == [(1, 0)]  # not exposed again
    np.testing.assert_array_equal(frames, OperatorRig.capture(rig, ON, [(1, 0)]))


def test_the_server_finishes_the_current_exposure(rig: SlowRig) -> None:
    rig.seconds = 0.3
    with running(rig) as server, server.http() as http:
        headers = headers_of(lease_of(http))
        encoded = encode_patterns(np.repeat(ON, 20, axis=0), [(1, i) for i in range(20)])
        answers = []
        posting = threading.Thread(
            target=lambda: answers.append(
                http.post("/v1/captures", content=encoded, headers=headers)
            )
        )
        posting.start()
        assert rig.began.wait(60)
        server.worker.stop()
        posting.join()
        assert http.get("/v1/health").json()["status"] == "stopping"
    assert answers[0].status_code == 503
    assert "is stopping" in answers[0].json()["detail"]
    assert (len(rig.shown), rig.closed) == (1, 1)


CLOSING_RIG = """
from tests.server.harness import TOKEN, SlowRig
from rfpipe.server import ServerSettings
from rfpipe.server.run import serve

class Rig(SlowRig):
    def close(self):
        print("closed", flush=True)

serve(Rig(), TOKEN, ServerSettings(port=0))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_closes_the_rig(number: signal.Signals) -> None:
    server = subprocess.Popen(
        [sys.executable, "-c", CLOSING_RIG], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        while "startup complete" not in (line := server.stderr.readline()):  # type: ignore[union-attr]
            assert line
        server.send_signal(number)
        assert server.communicate(timeout=60)[0] == "closed\n"
    finally:
        server.kill()


def test_a_port_in_use_is_named(server: Running) -> None:
    with (
        pytest.raises(ConfigError, match=rf"port {server.port}.*choose another --port"),
        bound_socket("127.0.0.1", server.port),
    ):
        pass


def test_the_token_is_in_no_answer(http: httpx.Client) -> None:
    for path in ("/v1/health", "/v1/status", "/v1/rig", "/v1/openapi.json", "/v1/nothing"):
        assert TOKEN not in http.get(path, headers=RIGHT).text
