"""The last line of a run: failures with their logs, and targets that were missed."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import pytest

from rfpipe.jobs.outcome import (
    FailedJob,
    FailedJobs,
    clear_failures,
    failure_line,
    missed_targets,
    read_failures,
    write_failures,
)
from rfpipe.store import write_manifest


@pytest.mark.parametrize(
    ("rule", "log", "text"),
    [
        ("capture_simulated", "results/b/dual/L02/capture.log", "b by dual, level 2, capture"),
        ("acquire", "results/b/dual/acquire.log", "b by dual, acquire"),
        ("evaluate", "results/report/evaluate.log", "evaluate"),
        ("bound", "results/verified.log", "bound"),
        ("calibrate", "", "calibrate"),
    ],
)
def test_a_failure_names_scene_stage_and_log(
    rule: str, log: str, text: str, tmp_path: Path
) -> None:
    failure = FailedJob.of_log(rule, log)
    assert str(failure) == text
    line = failure_line([failure], Path("night"))
    assert line == f"failed: {text}" + (f" (night/{log})" if log else "")
    write_failures(tmp_path, [failure])
    assert read_failures(tmp_path) == [failure]
    clear_failures(tmp_path)
    assert read_failures(tmp_path) == []


def test_jobs_that_succeed_when_retried_are_no_failures(tmp_path: Path) -> None:
    from snakemake_interface_logger_plugins.common import LogEvent

    jobs = FailedJobs()
    for name in ("a", "b"):
        record = logging.makeLogRecord(
            {
                "event": LogEvent.JOB_ERROR,
                "rule_name": "acquire",
                "output": [str(tmp_path / f"{name}.json")],
                "log": [f"results/{name}/dual/acquire.log"],
            }
        )
        jobs.emit(record)
        jobs.emit(record)
    jobs.emit(logging.makeLogRecord({"event": LogEvent.PROGRESS}))
    (tmp_path / "a.json").touch()
    assert [failure.scene for failure in jobs.failures()] == ["b"]


def acquisition(results: Path, estimate: float | None, measured: float | None = None) -> None:
    """Write manifests of a finished acquisition, with a target error of 1 %."""
    folder = results / "vase" / "auto"
    levels: list[dict[str, Any]] = [{"level": 0, "patterns": 1}, {"level": 1, "patterns": 12}]
    if estimate is not None:
        levels[1]["estimated_error"] = estimate
    levels[1]["ended"] = "all rounds are shown"
    facts = {
        "scene": "vase", "method": "auto", "levels": levels,
        "inputs": {"refine": [[0, "x"], [1, "y"]]},
        "options": {"target_error": 0.01, "target_indirect": None},
    }  # fmt: skip
    write_manifest(folder / "transport.json", facts)
    if measured is not None:
        write_manifest(folder / "verification.json", {"mean_error": measured})


@pytest.mark.parametrize(
    ("estimate", "measured", "missed"),
    [
        (0.009, None, ""),
        (None, None, ""),
        (
            0.04,
            None,
            "vase by auto, estimated error 4 %, target 1 % (all rounds are shown)",
        ),
        (0.009, 0.014, ""),
        (
            0.009,
            0.15,
            "vase by auto, measured error 15 %, target 1 % (all rounds are shown)",
        ),
        (0.04, 0.009, ""),
    ],
)
def test_a_missed_target_is_named_with_its_error(
    estimate: float | None, measured: float | None, missed: str, tmp_path: Path
) -> None:
    acquisition(tmp_path, estimate, measured)
    misses = missed_targets(tmp_path, [("vase", "auto"), ("jug", "auto")], margin=1.5)
    assert [str(miss) for miss in misses] == ([missed] if missed else [])
