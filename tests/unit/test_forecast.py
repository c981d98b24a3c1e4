"""Forecasts of runs: patterns, time, memory and disk space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from tests.rigs.known_matrix import run

import rfpipe
from rfpipe.blocks import RayDomain
from rfpipe.config import Config
from rfpipe.jobs import workers
from rfpipe.methods.adaptive.decisions import EXPECTED_PATTERNS, EXPECTED_POWER
from rfpipe.methods.base import get_method, options_of
from rfpipe.rigs import OperatorRig
from rfpipe.stages.forecast import forecast
from rfpipe.store import files

ACQUISITIONS = Path(__file__).parents[2] / "docs" / "benchmark" / "acquisitions.csv"


def settings(**changes: Any) -> Config:
    scene = {"kind": "plane", "surfaces": ["texture"], "shape": [5, 7]}
    return Config.model_validate({"scenes": {"wall": scene}} | changes)


def only(**changes: Any) -> Any:
    (row,) = forecast(settings(**changes)).itertuples()
    return row


def test_a_forecast_counts_patterns_references_and_the_warm_up() -> None:
    capture = {"seconds_per_pattern": 3.0, "all_off_brackets": 2, "all_on_brackets": 5}
    capture["warm_up_minutes"] = 4
    row = only(methods={"brute_force": {}}, capture=capture)
    assert (row.scene, row.method, row.rays) == ("wall", "brute_force", 35)
    assert row.patterns == 35
    assert row.seconds == 240 + 3 * (35 + 7)
    dropped = only(methods={"brute_force": {}}, capture={**capture, "keep_raw": False})
    assert row.disk - dropped.disk == 35 * (4 * 35 * 3 * 2 + 4096)  # their brackets


@pytest.mark.parametrize("method", ["auto", "near_far", "footprints"])
def test_a_smaller_error_takes_more_patterns(method: str) -> None:
    shape = {"kind": "plane", "surfaces": ["texture"], "shape": [40, 40]}
    rows = [
        only(scenes={"wall": shape}, methods={method: {"target_error": target}})
        for target in (0.05, 0.01, 0.002)
    ]
    assert [row.patterns for row in rows] == [8, 30, 109]
    assert all(row.patterns < row.max_patterns for row in rows)
    assert all(row.seconds < row.max_seconds and row.disk < row.max_disk for row in rows)
    auto, small = get_method("auto"), RayDomain((16, 18))
    options = options_of(auto, target_error=1e-5)
    forecast = auto.forecast(small, small, 3, options)
    assert forecast.max_patterns > 451  # an acquisition of such a scene took 451 patterns
    few = only(scenes={"wall": shape}, methods={method: {"patterns": 20}})
    assert (few.patterns, few.max_patterns) == (20, 20)


@pytest.mark.slow  # compiles the kernels of all methods
@pytest.mark.parametrize("is_symmetric", [True, False])
@pytest.mark.parametrize("method", ["auto", "near_far", "footprints"])
def test_no_acquisition_of_a_small_scene_exceeds_the_upper_limit(
    method: str, is_symmetric: bool
) -> None:
    if method == "near_far" and not is_symmetric:
        return
    shape, rng = (8, 9), np.random.default_rng(1)
    matrix = rng.random((72, 72)) ** 8 + np.eye(72)
    matrix = matrix + matrix.T if is_symmetric else matrix
    rig = OperatorRig((matrix / matrix.sum(axis=1).max()).astype(np.float32), shape, shape)
    result = rfpipe.acquire(rig, method, target_error=1e-5, progress=False)
    rays = RayDomain(shape)
    options = options_of(get_method(method), target_error=1e-5)
    limit = get_method(method).forecast(rays, rays, 3, options).max_patterns
    assert 72 < result.patterns <= limit


def test_expected_patterns_agree_with_the_open_benchmark() -> None:
    acquisitions = pd.read_csv(ACQUISITIONS)
    acquisitions = acquisitions[
        (acquisitions["option"] == "target_error") & (acquisitions["status"] == "done")
    ]
    acquisitions = acquisitions[acquisitions["camera_rays"] >= 48 * 48]
    is_open = ~acquisitions["held_out_scene"].astype(bool) & ~acquisitions["held_out_seed"].astype(
        bool
    )
    views = np.where(acquisitions["scene"].str.startswith("views"), 9, 1)
    expected = views * EXPECTED_PATTERNS * (0.01 / acquisitions["value"]) ** EXPECTED_POWER
    times = acquisitions["patterns"] / expected
    assert np.quantile(times[is_open], [0.25, 0.5, 0.75]) == pytest.approx([0.75, 1.1, 1.75], 0.1)
    assert np.quantile(times[~is_open], [0.25, 0.5, 0.75]) == pytest.approx([0.77, 3.6, 6.8], 0.1)


PLANE = {"kind": "plane", "surfaces": ["texture"]}
CAPTURED = {"kind": "captured", "shape": [20, 20]}


@pytest.mark.parametrize(
    ("changes", "jobs", "why"),
    [
        ({}, "acquisition", "no scene has more than 4,000 rays"),
        ({"scenes": {"wall": {**PLANE, "shape": [62, 70]}}}, "stage", "a scene has 4,340 rays"),
        (
            {"scenes": {"wall": PLANE | {"shape": [8, 8]}, "other": PLANE | {"shape": [80, 80]}}},
            "stage",
            "a scene has 6,400 rays",
        ),
        ({"resources": {"jobs": "stage"}}, "stage", "as set by resources.jobs"),
        (
            {"scenes": {"desk": CAPTURED}, "capture": {"rig": "offline"}, "methods": {"dual": {}}},
            "stage",
            "its pictures are taken elsewhere",
        ),
    ],
)
def test_small_acquisitions_are_one_job(changes: dict[str, Any], jobs: str, why: str) -> None:
    config = settings(**changes)
    assert config.jobs == jobs
    assert why in config.jobs_and_reason[1]


@pytest.mark.parametrize(("count", "message"), [(1, "1 acquisition."), (2, "2 acquisitions.")])
def test_the_command_counts_acquisitions(count: int, message: str, tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    scenes = {f"s{index}": {**PLANE, "shape": [5, 7]} for index in range(count)}
    config.write_text(yaml.safe_dump({"scenes": scenes, "methods": {"dual": {}}}))
    output = run("plan", config)
    assert f"valid. {message} One job per acquisition, since no scene" in output
    assert ("One after the other" in output) == (count > 1)


def test_the_command_warns_of_too_little_disk_and_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = tmp_path / "config.yaml"
    scene = "{kind: wedge, surfaces: [white, white]}"
    config.write_text(f"scenes: {{one: {scene}, other: {scene}}}\nmethods: {{dual: {{}}}}")
    output = run("plan", config, "--folder", tmp_path / "results")
    assert output.count("dual") == 2
    assert "One after the other: 4:54:08" in output
    assert "may be too small" not in output
    assert "of memory, but this machine" not in output

    monkeypatch.setattr(workers, "machine_memory_mb", lambda: 128)
    monkeypatch.setattr(files, "free_bytes", lambda _folder: 10)
    output = run("plan", config)
    assert "may be too small" in output
    assert "by dual probably needs" in output
    assert "MB of memory, but this machine has 128 MB" in output
