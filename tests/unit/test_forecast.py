"""What a run will take, told before it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.helpers import run

from rfpipe.config import Config
from rfpipe.stages.forecast import forecast
from rfpipe.stages.jobs import workers
from rfpipe.store import files


def settings(**changes: Any) -> Config:
    scene = {"kind": "plane", "surfaces": ["texture"], "shape": [5, 7]}
    return Config.model_validate({"scenes": {"wall": scene}} | changes)


def only(**changes: Any) -> Any:
    (row,) = forecast(settings(**changes)).itertuples()
    return row


def test_it_counts_patterns_references_and_the_warm_up() -> None:
    capture = {"seconds_per_pattern": 3.0, "black_frames": 2, "floodlit_frames": 5}
    capture["warm_up_minutes"] = 4
    row = only(methods={"brute_force": {}}, capture=capture)
    assert (row.scene, row.method, row.rays) == ("wall", "brute_force", 35)
    assert row.patterns == 35
    assert row.seconds == 240 + 3 * (35 + 7)
    dropped = only(methods={"brute_force": {}}, capture={**capture, "keep_raw": False})
    assert row.disk - dropped.disk == 35 * (4 * 35 * 3 * 2 + 4096)  # their brackets


def test_the_command_says_what_does_not_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "config.yaml"
    scene = "{kind: wedge, surfaces: [white, white]}"
    config.write_text(f"scenes: {{one: {scene}, other: {scene}}}\nmethods: {{dual: {{}}}}")
    told = run("plan", config, "--folder", tmp_path / "results")
    assert told.count("dual") == 2
    assert "One after the other: 4:54:08" in told
    assert "may not fit" not in told
    assert "of memory, and this machine" not in told

    monkeypatch.setattr(workers, "machine_memory_mb", lambda: 128)
    monkeypatch.setattr(files, "free_bytes", lambda _folder: 10)
    told = run("plan", config)
    assert "may not fit" in told
    assert "by dual is likely to take" in told
    assert "of memory, and this machine has 128 MB" in told
