"""Limits of the server's memory, and of the time for which a request can block others."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.server.harness import RIGHT, SlowRig, head_of_capture, running
from tests.server.test_attacks import crowd
from tests.services.ports import free_port
from tests.services.waiting import wait_until

from rfpipe.rigs.messages import MEDIA_TYPE, Message, encode_patterns, pack_message

pytestmark = pytest.mark.slow

SHAPE = (1080, 1920)

LARGE_RIG = """
import sys, time
import numpy as np
from rfpipe.photometry import CameraModel
from rfpipe.server import ServerSettings
from rfpipe.server.run import serve

class LargeRig:
    camera_shape = projector_shape = (1080, 1920)
    channels, seconds_per_pattern = 1, 0.0
    sensor = CameraModel(exposures=(0.1, 1.0))

    def capture(self, patterns, keys):
        time.sleep(0.05)
        return np.ones((len(keys), 2, 1080, 1920, 1), np.uint16)

    def describe(self):
        return {"sensor": self.sensor.describe()}

serve(LargeRig(), sys.argv[1], ServerSettings(port=int(sys.argv[2]), lease_seconds=60))
"""


@pytest.fixture
def process(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """Start a server in a separate process, so that its memory can be measured."""
    port = free_port()
    (tmp_path / "rig.py").write_text(LARGE_RIG)
    token = RIGHT["Authorization"].split()[1]
    command = [sys.executable, str(tmp_path / "rig.py"), token, str(port)]
    with (tmp_path / "log").open("wb") as log:
        server = subprocess.Popen(command, stderr=log)
    try:
        url = f"http://127.0.0.1:{port}"
        wait_until(lambda: "startup complete" in (tmp_path / "log").read_text(), "its start", 0.05)
        yield server, url
    finally:
        server.kill()
        server.wait()


def peak_bytes(server: subprocess.Popen[bytes]) -> int:
    status = Path(f"/proc/{server.pid}/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


def bodies(patterns: int) -> dict[str, bytes]:
    """Return request bodies that need much memory: by compression, or by size."""
    lines = (np.arange(SHAPE[0])[:, None] // 4 % patterns == np.arange(patterns)[:, None, None]) * 1
    stripes = np.broadcast_to(lines, (patterns, *SHAPE)).astype(np.float32)
    keys = [(1, index) for index in range(patterns)]
    facts = {"keys": keys}
    heavy = Message(facts)
    heavy.add("patterns", np.zeros((8, 2**20 - 100), np.float64))
    return {
        "stripes": encode_patterns(stripes, keys),
        "gaps": encode_patterns(1 - stripes, keys),
        "bomb": pack_message(
            facts, {"patterns": np.zeros((patterns, *SHAPE), np.float32)}, deflate=True
        ),
        "large": heavy.content(),
        "crowd": crowd(1_400_000),
    }


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to see memory")
def test_no_request_takes_a_gigabyte_of_memory(
    process: tuple[subprocess.Popen[bytes], str],
) -> None:
    server, url = process
    with httpx.Client(base_url=url, headers=RIGHT, trust_env=False, timeout=60) as http:
        limits = http.get("/v1/rig").json()["limits"]
        sent = bodies(limits["patterns"])
        assert max(len(sent["stripes"]), len(sent["gaps"])) < limits["request_bytes"] // 10
        lease = http.post("/v1/lease", json={"client": "attacker"}).json()["lease"]

        def post(number: int, body: bytes) -> int:
            headers = {"Rig-Lease": lease, "Idempotency-Key": f"attack-{number:016}"}
            answer = http.post(
                "/v1/captures", content=body, headers={**headers, "Content-Type": MEDIA_TYPE}
            )
            return answer.status_code

        with ThreadPoolExecutor(6) as pool:
            kinds = [*sent, "stripes"]
            statuses = set(pool.map(post, range(6), (sent[kind] for kind in kinds)))
            assert statuses <= {200, 422, 429}
            # the same one six times, which are answered by one exposure
            assert set(pool.map(post, [99] * 6, [sent["gaps"]] * 6)) == {200}
    print(f"{peak_bytes(server):,} bytes at most")
    assert peak_bytes(server) < 10**9


def test_a_client_without_the_token_is_refused_before_its_body() -> None:
    with running(SlowRig()) as server:
        for path, headers in (("/v1/health", {}), ("/v1/rig", {"Authorization": "Bearer wrong"})):
            answer = httpx.get(f"{server.url}{path}", headers=headers, trust_env=False)
            assert answer.headers["connection"] == "close"
            known: Any = httpx.get(f"{server.url}{path}", headers=RIGHT, trust_env=False)
            assert "connection" not in known.headers


def test_a_busy_rig_is_reported_before_the_body_is_read() -> None:
    rig = SlowRig()
    rig.go_on.clear()
    with running(rig) as server, server.http() as http:
        lease = http.post("/v1/lease", json={"client": "test"}).json()["lease"]
        headers = {"Rig-Lease": lease, "Content-Type": MEDIA_TYPE}
        body = encode_patterns(np.ones((1, 3, 7), np.float32), [(1, 0)])
        with ThreadPoolExecutor(1) as pool:
            first = pool.submit(
                http.post, "/v1/captures", content=body,
                headers={**headers, "Idempotency-Key": "the-first-capture"},
            )  # fmt: skip
            assert rig.began.wait(60)
            with socket.create_connection(("127.0.0.1", server.port), timeout=60) as connection:
                second = {**headers, "Idempotency-Key": "the-second-capture"}
                connection.sendall(head_of_capture(second, 60_000))  # of which nothing is sent
                assert connection.recv(12) == b"HTTP/1.1 429"
            rig.go_on.set()
            assert first.result().status_code == 200
