"""Server, client or both killed in the middle of a capture of the bench: the rest comes as before.

On the simulated rig the same leaves the same bytes (tests/workflow/test_remote.py); here every
bracket has noise of its own, so that what comes is within noise of an undisturbed capture.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.waiting import wait_until
from tests.workflow.harness import ROOT, journal
from tests.workflow.test_remote import Server

from rfpipe.stages import merge
from rfpipe.stages.capturing.sensors import read_sensor
from rfpipe.stages.folder import AcquisitionFolder

pytestmark = pytest.mark.slow

CAMERA, RAYS = (22, 28), (8, 10)
PATTERNS = 80

BENCH = {
    "kind": "devices",
    "rays": RAYS,
    "projector": {"options": {"settle_seconds": 0}},
    "sensor": {"exposures": [1 / 64, 1 / 8]},
    "bench": {
        "scene": {"kind": "wedge", "surfaces": ["white", "texture"], "shape": RAYS, "channels": 1},
        "display_shape": [60, 70],
        "camera_shape": CAMERA,
    },
}

CLIENT = f"""
import sys
from pathlib import Path
from rfpipe.stages import hardware, schedule
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.stages.plan import Plan

folder, url, token = sys.argv[1:]
plan = Plan("brute_force", "brute_force", {CAMERA}, {RAYS}, 1)
rays = hardware.Rays({CAMERA}, {RAYS}, 1)
acquisition = AcquisitionFolder(Path(folder))
schedule.run(plan, acquisition, 0, "code")
hardware.run(
    rays, acquisition, 0,
    url=url, token_file=token, patience_seconds=60.0, references=(8, 8), batch_patterns=1,
)
"""


class BenchServer(Server):
    """``rfpipe serve`` with the optical bench."""

    def start(self) -> None:
        self.settings = yaml.safe_load(yaml.safe_dump(_plain(BENCH)))
        super().start()


def _plain(value):  # type: ignore[no-untyped-def]
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    return list(value) if isinstance(value, tuple) else value


class Capture:
    """The capture of one level in a folder of its own."""

    def __init__(self, path: Path, server: Server) -> None:
        self.path, self.server = path, server
        self.store = path / "L00/capture.zarr"

    def start(self) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-c", CLIENT,
             str(self.path), self.server.url, str(self.server.token_file)],
            cwd=ROOT,
        )  # fmt: skip

    def end(self, client: subprocess.Popen[bytes]) -> None:
        assert client.wait(120) == 0

    def merged(self) -> Merged:
        """Return the radiance of all patterns, and its variance."""
        folder = AcquisitionFolder(self.path)
        merge.run(
            read_sensor(folder), folder, 0,
            saturation_fraction=0.98, mask_defects=False, code="code",
        )  # fmt: skip
        with folder.frames(0, "merge") as merged:
            images = merged.read(0, PATTERNS)
        return images[:, 0].astype(np.float64), images[:, 1].astype(np.float64)


@pytest.fixture
def server(tmp_path: Path) -> Iterator[BenchServer]:
    server = BenchServer(tmp_path, {})
    server.start()
    yield server
    server.kill()


Merged = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Merged, Merged]:
    """Two captures that nobody disturbed: what they differ by is noise.

    The second one has noise that is no other capture's: each server's begins alike.
    """
    folder = tmp_path_factory.mktemp("undisturbed")
    server = BenchServer(folder, {})
    server.start()
    try:
        captures = [Capture(folder / name, server) for name in ("one", "two")]
        for capture in captures:
            capture.end(capture.start())
        return captures[0].merged(), captures[1].merged()
    finally:
        server.kill()


def difference(one: Merged, other: Merged) -> np.ndarray:
    """Return by how many standard deviations each pattern's picture differs, RMS."""
    (radiance, variance), (expected, its_variance) = one, other
    deviations = (radiance - expected) / np.sqrt(variance + its_variance)
    return np.sqrt(np.mean(deviations**2, axis=tuple(range(1, deviations.ndim))))


@pytest.mark.parametrize("killed", ["server", "client", "both"])
def test_a_capture_of_the_bench_goes_on_after_kill_9(
    killed: str,
    tmp_path: Path,
    server: BenchServer,
    undisturbed: tuple[Merged, Merged],
) -> None:
    capture = Capture(tmp_path / "capture", server)
    client = capture.start()
    wait_until(lambda: len(journal(capture.store)) >= 20, "the first patterns")
    client.send_signal(signal.SIGSTOP)
    assert 20 <= len(journal(capture.store)) < PATTERNS
    if killed != "client":
        server.kill()
    if killed != "server":
        client.kill()
        client.wait()
    captured = len(journal(capture.store))
    if killed != "client":
        server.start()
    if killed == "server":
        os.kill(client.pid, signal.SIGCONT)
    else:
        client = capture.start()
    capture.end(client)
    # nothing that was captured is exposed again
    shown = server.status()["brackets"] - (PATTERNS - captured)
    assert shown <= (1 if killed != "client" else captured + 16 + 1)
    first, second = undisturbed
    noise = difference(first, second)
    found = difference(capture.merged(), second)
    assert 0.5 < noise.mean() < 1.1  # pixels without light have no counts that could differ
    assert found.mean() == pytest.approx(noise.mean(), rel=0.05)
    assert found.max() < 1.1 * noise.max()  # no pattern's picture is another's
