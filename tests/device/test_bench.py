"""The optical bench in software: what comes through window and camera driver is the simulation.

And the rig's contract on it, as on any rig of hardware; all on either kind of display.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.waiting import wait_until

from rfpipe.config import RigConfig, parse_rig_config
from rfpipe.errors import CaptureError
from rfpipe.keys import BLACK_LEVEL_KEY
from rfpipe.photometry import MergeOptions
from rfpipe.rigs import DeviceRig
from rfpipe.rigs.bench import optical_path
from rfpipe.rigs.build import rig_from_config
from rfpipe.rigs.displays import XServer
from rfpipe.testing import CameraContract, ProjectorContract, RigContract

pytestmark = pytest.mark.usefixtures("either_display")

RAYS = (8, 10)


def settings(**changes: Any) -> RigConfig:
    scene = {"kind": "wedge", "surfaces": ["white", "texture"], "shape": RAYS, "channels": 1}
    bench = {
        "scene": scene,
        "display_shape": [60, 70],
        "camera_shape": [22, 28],
        **changes.pop("bench", {}),
    }
    plain = {
        "rays": RAYS,
        "projector": {"options": {"settle_seconds": 0}},
        "sensor": {"exposures": [1 / 64, 1 / 8]},
        "bench": bench,
        **changes,
    }
    return parse_rig_config(plain, "bench")


COLOUR = {
    "camera": {"options": {"pixel_format": "BayerRG12"}},
    "sensor": {"exposures": [1 / 64, 1 / 8], "bayer": "RGGB"},
    "bench": {
        "scene": {
            "kind": "wedge", "surfaces": ["white", "texture"], "shape": RAYS, "channels": 3
        }
    },
}  # fmt: skip


def bench(**changes: Any) -> DeviceRig:
    rig = rig_from_config(settings(**changes))
    assert isinstance(rig, DeviceRig)
    return rig


@pytest.fixture(scope="module")
def rig(either_display: str) -> Iterator[DeviceRig]:
    with bench() as rig:
        yield rig


class TestBenchAsARig(RigContract):
    repeatable = False

    def make_rig(self) -> DeviceRig:
        return bench()


class TestBenchCamera(CameraContract):
    @pytest.fixture(autouse=True)
    def _projectors(self) -> Iterator[None]:
        with ExitStack() as self.open:
            yield

    def make_camera(self):  # type: ignore[no-untyped-def]
        rig = bench()
        self.open.callback(rig.projector.close)
        rig.projector.show(np.ones(rig.projector.shape, np.float32))
        return rig.camera


class TestBenchProjector(ProjectorContract):
    def make_projector(self):  # type: ignore[no-untyped-def]
        rig = bench()
        rig.camera.close()
        return rig.projector

    def read_back(self, projector):  # type: ignore[no-untyped-def]
        return projector.display.pixels[..., 0].astype(np.float32) / 255


def merged(rig: DeviceRig, patterns: np.ndarray):  # type: ignore[no-untyped-def]
    """Capture patterns, and the black level before them; return the radiance images."""
    dark = np.zeros((8, *rig.projector_shape), np.float32)
    black = rig.capture(dark, [(BLACK_LEVEL_KEY, index) for index in range(8)])
    frames = rig.capture(patterns, [(0, index) for index in range(len(patterns))])
    mean = black.mean(axis=0, dtype=np.float64).astype(np.float32)
    return rig.sensor.merge(frames, mean, MergeOptions(black_count=8))


def test_a_bracket_is_the_simulation_within_its_noise(rig: DeviceRig) -> None:
    patterns = (np.random.default_rng(0).random((6, *RAYS)) < 0.5).astype(np.float32)
    images = merged(rig, patterns)
    config = settings()
    assert config.bench is not None
    path = optical_path(config.bench, rig.projector.shape)
    expected = np.stack([path.radiance(path.layout.picture(pattern)) for pattern in patterns])
    deviation = (images.radiance - expected) / np.sqrt(images.variance)
    assert images.saturated == 0
    assert abs(deviation.mean()) < 6 / np.sqrt(deviation.size / 9)  # eight black frames are shared
    assert np.square(deviation).mean() == pytest.approx(1, abs=0.1)
    assert np.abs(images.radiance - expected).mean() < 0.01 * expected.mean()


def test_a_bracket_in_colour_is_the_simulation() -> None:
    white = np.ones((1, *RAYS), np.float32)
    config = settings(**COLOUR)
    assert config.bench is not None
    with bench(**COLOUR) as rig:
        seen = merged(rig, white).radiance[0]
        path = optical_path(config.bench, rig.projector.shape)
        light = path.radiance(path.layout.picture(white))
        simulated = rig.sensor.expose(light, 1, (0,))[None]
        dark = rig.sensor.expose(np.zeros_like(light), 1, (1,)).astype(np.float32)
        expected = rig.sensor.merge(simulated, dark).radiance[0]
    assert seen.mean(axis=(0, 1)) == pytest.approx(expected.mean(axis=(0, 1)), rel=0.01)
    assert np.abs(seen - expected).mean() < 0.03 * expected.mean()


def test_the_camera_has_its_own_numbers() -> None:
    true = {"black_level_counts": 200, "read_noise_electrons": 30, "dark_current_electrons": 0}
    with bench(bench={"camera": true}) as rig:
        dark = np.zeros((1, *rig.projector_shape), np.float32)
        frames = rig.capture(dark, [(0, 0)])
        assert frames.mean() == pytest.approx(200, abs=1)
        per_count = 20_000 / (4095 - 200)
        assert frames.std() == pytest.approx(30 / per_count, rel=0.1)
        assert rig.sensor.describe()["black_level_counts"] == 64


def test_a_lost_display_names_the_pattern(monkeypatch: pytest.MonkeyPatch) -> None:
    with bench() as rig:
        projector: Any = rig.projector
        monkeypatch.setattr(projector, "_reopen_seconds", 0.0)
        monkeypatch.setattr(projector, "_before_opening", lambda: None)  # it stays away
        projector._server.close()
        with pytest.raises(CaptureError, match=r"pattern \(3, 14\): projector on display"):
            rig.capture(np.ones((1, *RAYS), np.float32), [(3, 14)])


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    rig = bench()
    assert list(tmp_path.iterdir())
    rig.close()
    assert not list(tmp_path.iterdir())


def test_a_killed_bench_leaves_no_process_behind(tmp_path: Path, either_display: str) -> None:
    code = (
        "import sys, json, time, os\n"
        "from rfpipe.config import parse_rig_config\n"
        "from rfpipe.rigs.build import rig_from_config\n"
        "rig = rig_from_config(parse_rig_config(json.loads(sys.argv[1]), 'bench'))\n"
        "window = rig.projector._window._process.pid\n"
        "print(window, rig.projector.display.name, flush=True)\n"
        "time.sleep(60)\n"
    )
    plain = settings().model_dump_json()
    process = subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", code, plain],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    assert process.stdout is not None
    window, name = process.stdout.readline().split()
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert name.startswith("memory:") is (either_display == "memory")
    ends = [Path(f"/proc/{window}")]
    if either_display == "x server":
        ends.append(Path(f"/tmp/.X11-unix/X{name.removeprefix(':')}"))
    wait_until(lambda: not any(path.exists() for path in ends), "the end of window and display")


@pytest.mark.needs("xvfb")
@pytest.mark.parametrize("either_display", ["x server"], indirect=True)
def test_a_display_that_is_killed_costs_a_pattern(either_display: str) -> None:
    """kill -9 of the X server, in the midst of patterns, of a bracket, and of its window.

    Another server takes its display once, which then has a picture of its own.
    """
    patterns = (np.random.default_rng(0).random((12, *RAYS)) < 0.5).astype(np.float32)
    with bench() as undisturbed, bench(seed=1) as rig, ExitStack() as thief:
        expected = merged(undisturbed, patterns)
        expose, taken = rig.camera.expose, []

        def failing_camera() -> np.ndarray:
            taken.append(0)
            if len(taken) in (11, 15):  # after eight black ones, before and after an exposure
                os.kill(rig.projector.display.pid, signal.SIGKILL)
            if len(taken) == 15:
                os.waitpid(rig.projector.display.pid, 0)
                with suppress(CaptureError):  # taken by another test, as well
                    thief.enter_context(XServer((10, 10), name=rig.projector.display.name))
            frames = expose()
            if len(taken) == 18:
                os.kill(rig.projector.display.pid, signal.SIGKILL)
            return frames

        rig.camera.expose = failing_camera
        images = merged(rig, patterns)
        assert rig.statistics["projector"]["reopened"] == 3
        assert len(taken) <= 8 + 12 + 3
    deviation = (images.radiance - expected.radiance) / np.sqrt(images.variance + expected.variance)
    assert np.square(deviation).mean() == pytest.approx(1, abs=0.1)


def test_a_knock_moves_the_picture_from_then_on() -> None:
    plain = settings(bench={"knock": [2, 0, 3]})  # after one bracket of two exposures
    with rig_from_config(plain) as rig:  # type: ignore[attr-defined]
        pattern = (np.random.default_rng(0).random((1, *RAYS)) < 0.5).astype(np.float32)
        before, after, still = (
            rig.capture(pattern, [(0, index)])[0, 1].astype(float) for index in range(3)
        )
    moved, noise = np.abs(after - before).mean(), np.abs(still - after).mean()
    assert moved > 5 * noise
