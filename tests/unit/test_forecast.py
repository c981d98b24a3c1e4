"""What a run will take, told before it."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rfpipe.cli import app
from rfpipe.config import Config
from rfpipe.photometry import CameraModel, ExactSensor
from rfpipe.stages.capturing.forecast import forecast
from rfpipe.stages.capturing.taken import taken_in
from rfpipe.stages.plan import Plan
from rfpipe.store import write_manifest


def settings(**changes: object) -> Config:
    scene = {"kind": "plane", "surfaces": ["texture"], "shape": [5, 7]}
    return Config.model_validate({"scenes": {"wall": scene}} | changes)


def test_it_counts_patterns_references_looks_and_the_warm_up() -> None:
    capture = {
        "seconds_per_pattern": 3.0,
        "black_frames": 2,
        "floodlit_frames": 5,
        "warm_up_minutes": 4,
        "drift_minutes": 0.5,
    }
    (only,) = forecast(settings(methods={"brute_force": {}}, capture=capture), CameraModel())
    assert (only.scene, only.method, only.rays) == ("wall", "brute_force", 35)
    assert only.expected.patterns == only.most.patterns == 35
    looks = math.ceil(35 / 10) + 1
    assert only.expected.seconds == 240 + 3 * (35 + 7 + looks)
    bracket = 4 * 35 * 3 * 2 + 4096
    assert only.expected.disk.raw == (35 + 7 + looks) * bracket
    dropped = settings(methods={"brute_force": {}}, capture={**capture, "keep_raw": False})
    (other,) = forecast(dropped, CameraModel())
    assert other.expected.disk.raw == (7 + looks) * bracket


def test_a_method_that_descends_shows_at_most_every_block() -> None:
    (only,) = forecast(settings(methods={"symmetric": {}}), ExactSensor())
    assert only.levels == 4
    assert only.most.patterns == 1 + 4 + 16 + 35
    assert only.expected.patterns == 35  # the thesis' scenes took 434 for four levels
    assert only.most.seconds == 2.0 * (
        56 + 2 + 6
    )  # with the random patterns that tell whether the rig is coaxial


def test_it_learns_from_acquisitions_that_are_there(tmp_path: Path) -> None:
    facts = {
        "scene": "wall", "method": "symmetric", "acquired_by": "symmetric",
        "camera_shape": [5, 7], "projector_shape": [5, 7], "channels": 3, "patterns": 20,
        "options": Plan("symmetric", "symmetric", (5, 7), (5, 7), 3).options.options(),
    }  # fmt: skip
    place = tmp_path / "wall" / "symmetric"
    write_manifest(place / "transport.json", facts)
    for stage in ("capture", "merge"):
        (place / "L00").mkdir(exist_ok=True)
        (place / f"L00/{stage}.benchmark.tsv").write_text("s\n1.5\n")
    (tmp_path / "wall/dual").mkdir()
    (tmp_path / "wall/dual/transport.json").write_text("damaged")
    taken = taken_in(tmp_path)
    assert [(one.patterns, one.seconds, one.capture_seconds) for one in taken] == [(20, 3.0, 1.5)]

    same = settings(methods={"symmetric": {}})
    (only,) = forecast(same, ExactSensor(), taken)
    assert (only.expected.patterns, only.known, only.here) == (20, "taken", 3.0)
    (other,) = forecast(settings(methods={"symmetric": {"tolerance": 0.1}}), ExactSensor(), taken)
    assert (other.expected.patterns, other.known) == (20, "alike")  # 35 are expected without
    (large,) = forecast(
        settings(
            methods={"symmetric": {}},
            scenes={"wall": {"kind": "plane", "surfaces": ["texture"], "shape": [50, 70]}},
        ),
        ExactSensor(),
        taken,
    )
    assert (large.known, large.here) == ("guess", None)


def test_the_command_says_what_does_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "config.yaml"
    scene = "{kind: wedge, surfaces: [white, white]}"
    config.write_text(f"scenes: {{one: {scene}, other: {scene}}}\nmethods: {{dual: {{}}}}")
    runner = CliRunner()
    result = runner.invoke(app, ["plan", str(config), "--folder", str(tmp_path / "results")])
    assert result.exit_code == 0
    assert result.output.count("dual") == 2
    assert "One after the other: 4 h 54 min" in result.output
    assert "2 of 2 are guesses on the high side" in result.output
    assert "may not fit" not in result.output
    assert "of memory, and this machine" not in result.output
    from rfpipe.stages.jobs import workers
    from rfpipe.store import files

    monkeypatch.setattr(workers, "machine_memory_mb", lambda: 128)
    monkeypatch.setattr(files, "free_bytes", lambda _folder: 10)
    result = runner.invoke(app, ["plan", str(config)])
    assert "may not fit" in result.output
    assert "by dual is likely to take" in result.output
    assert "of memory, and this machine has 128 MB: acquire it on another one" in result.output
