"""Runs with a rig on an acquisition server, and kills of the server and of the run."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from tests.services.ports import free_port
from tests.services.waiting import wait_until
from tests.workflow.harness import (
    CONFIG,
    LONG,
    Workflow,
    freeze_writer,
    journal,
    kill_group,
)
from tests.workflow.test_run_command import run

BRUTE = "long/brute_force"
TOKEN = "a-token-for-tests-only"
REFERENCES = 8

pytestmark = pytest.mark.slow


class Server:
    """A process of ``rfpipe serve`` with a simulated rig."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.folder = folder
        self.url = f"http://127.0.0.1:{self.port}"
        self.token_file = folder / "rig.token"
        self.token_file.write_text(TOKEN)
        self.token_file.chmod(0o600)
        self.settings = {"kind": "simulated", "scene": CONFIG["scenes"]["long"], "seed": 1}
        self.start()

    def start(self) -> None:
        (self.folder / "rig.yaml").write_text(yaml.safe_dump(self.settings))
        with (self.folder / "server.log").open("ab") as log:
            self.process = subprocess.Popen(
                [
                    str(Path(sys.executable).with_name("rfpipe")),
                    *("serve", str(self.folder / "rig.yaml"), "--port", str(self.port)),
                    *("--token-file", str(self.token_file), "--lease-seconds", "1"),
                ],
                stderr=log,
            )
        wait_until(self.answers, "the server")

    def answers(self) -> bool:
        try:
            return httpx.get(f"{self.url}/v1/health", trust_env=False).is_success
        except httpx.TransportError:
            return False

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(120)

    def status(self) -> dict[str, Any]:
        headers = {"Authorization": f"Bearer {TOKEN}"}
        answer = httpx.get(f"{self.url}/v1/status", headers=headers, trust_env=False)
        return dict(answer.json())

    def workflow(self, folder: Path, patience_seconds: int = 600, jobs: str = "stage") -> Workflow:
        """A run of the served scene by brute force."""
        capture = {
            "rig": "remote", "url": self.url, "token_file": str(self.token_file),
            "patience_seconds": patience_seconds,
            "watch": "off",  # the same patterns as for a simulated rig
        }  # fmt: skip
        scenes = {"long": CONFIG["scenes"]["long"]}
        of_run = {"scenes": scenes, "methods": {"brute_force": {}}, "resources": {"jobs": jobs}}
        return Workflow(folder, {**of_run, "capture": capture})


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    server = Server(tmp_path)
    yield server
    server.kill()


def test_the_client_waits_for_a_server_killed_during_a_level(
    tmp_path: Path, server: Server, undisturbed: Workflow
) -> None:
    workflow = server.workflow(tmp_path / "run")
    store = workflow.path(f"{BRUTE}/L00/capture.zarr")
    process = workflow.start(LONG)
    wait_until(lambda: len(journal(store)) >= 20, "the first patterns")
    server.kill()
    captured = len(journal(store))
    assert 12 <= captured < 40
    server.start()
    output = workflow.end(process)
    assert re.search(r"no answer .*check that 'rfpipe serve' is", output)
    assert "answers again; continuing" in output
    # the second server shows no pattern whose frames the client already has
    assert server.status()["brackets"] <= 40 - captured + 1
    # the same bytes as a simulated capture without a server
    assert workflow.contents(BRUTE) == undisturbed.contents(BRUTE)


@pytest.mark.parametrize("jobs", ["stage", "acquisition"])
def test_a_client_killed_during_a_level_continues(
    tmp_path: Path, server: Server, undisturbed: Workflow, jobs: str
) -> None:
    """The client is killed alone or together with its server."""
    workflow = server.workflow(tmp_path / "run", jobs=jobs)
    store = workflow.path(f"{BRUTE}/L00/capture.zarr")
    process = workflow.start(LONG)
    freeze_writer(store, 12)
    if jobs == "acquisition":
        server.kill()
    kill_group(process, signal.SIGKILL)
    process.communicate()
    captured = len(journal(store))
    assert 12 <= captured < 40
    if jobs == "acquisition":
        server.start()
    else:
        assert server.status()["holder"] is not None  # until its lease ends
    workflow.unlock()
    assert f"{captured} of 40 patterns are captured" in workflow.run(LONG)
    assert server.status()["holder"] is None
    assert server.status()["brackets"] <= 40 + REFERENCES + 1
    assert workflow.contents(BRUTE) == undisturbed.contents(BRUTE)


def test_a_server_that_does_not_return_ends_the_run_with_advice(
    tmp_path: Path, server: Server
) -> None:
    workflow = server.workflow(tmp_path / "run", patience_seconds=1)
    server.kill()
    output = workflow.run(LONG, succeeds=False)
    assert "check that 'rfpipe serve' is" in output
    assert "captured brackets are kept: run again after solving the problem" in output
    server.settings["scene"] = {**CONFIG["scenes"]["long"], "shape": [16, 16]}
    server.start()
    output = workflow.run(LONG, succeeds=False)
    assert "'projector_shape': (16, 16)" in output
    assert "the settings of the scene say" in output


def test_a_missed_target_fails_the_run_and_a_level_can_be_repeated(
    tmp_path: Path, server: Server
) -> None:
    server.kill()
    scene = {**CONFIG["scenes"]["long"], "shape": [8, 10]}
    server.settings["scene"] = scene
    server.start()
    workflow = server.workflow(tmp_path / "run", jobs="acquisition")
    settings = yaml.safe_load(workflow.config.read_text())
    settings["scenes"] = {"long": scene}
    settings["methods"] = {"near_far": {"target_error": 1e-4, "patterns": 13}}
    settings["verification"] = {"pictures": 3}
    workflow.config.write_text(yaml.safe_dump(settings))
    output = run(workflow, status=1)
    assert "long by near_far has a mean error of" in workflow.path("verified.log").read_text()
    last = output.splitlines()[-1]
    assert "missed the target error: long by near_far, measured error" in last
    assert "target 0.01 %" in last
    assert workflow.path("report/index.html").exists()

    shown = server.status()["brackets"]
    before = journal(workflow.path("long/near_far/L01/capture.zarr"))
    settings["verification"]["fail_above"] = 0.99
    workflow.config.write_text(yaml.safe_dump(settings))
    output = run(workflow, "--retake", "long/near_far/1")
    assert "the previous ones stay next to the new ones, as capture.before_1.zarr" in output
    # the verification pictures are reused
    assert server.status()["brackets"] == shown + len(before)
    assert "missed the target error" in output.splitlines()[-1]
