"""The outcome of a run: jobs that failed, and acquisitions that missed their target error."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rfpipe.errors import StoreError
from rfpipe.jobs.targets import misses
from rfpipe.store import manifest_or_empty, read_manifest, write_manifest
from rfpipe.transport.base import last_estimate

FAILED = "failed.json"
"""Manifest of the failed jobs of a run, in the folder of results."""

_MAX_NAMED = 4
"""Number of failures that the last line of a run names."""


@dataclass(frozen=True)
class FailedJob:
    """Failed job.

    Attributes
    ----------
    stage : str
    log : str
        Path of its log, relative to the run's folder.
    scene, method, level : str
        Acquisition and folder of the level; "" where the job belongs to none.
    """

    stage: str
    log: str
    scene: str = ""
    method: str = ""
    level: str = ""

    @classmethod
    def of_log(cls, stage: str, log: str) -> FailedJob:
        """Return the failure of a job, by its rule and its log, results/{scene}/{method}/..."""
        folders = Path(log).parts[1:-1]
        if len(folders) < 2 or folders[0] == "report":
            return cls(stage, log)
        level = folders[2] if len(folders) > 2 else ""
        return cls(Path(log).stem, log, folders[0], folders[1], level)

    def __str__(self) -> str:
        level = f"level {int(self.level[1:])}, " if self.level.startswith("L") else ""
        acquisition = f"{self.scene} by {self.method}, {level}" if self.scene else ""
        return f"{acquisition}{self.stage}"


class FailedJobs(logging.Handler):
    """Log handler that collects the jobs that Snakemake reports as failed."""

    def __init__(self) -> None:
        super().__init__()
        self._jobs: dict[str, tuple[FailedJob, list[Path]]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Record the job if the record reports a failed one."""
        from snakemake_interface_logger_plugins.common import LogEvent

        if getattr(record, "event", None) == LogEvent.JOB_ERROR:
            job: Any = record
            log = str(job.log[0]) if job.log else ""
            outputs = [Path(str(output)) for output in job.output]
            self._jobs[f"{job.rule_name} {log}"] = FailedJob.of_log(job.rule_name, log), outputs

    def failures(self) -> list[FailedJob]:
        """Return the failures, except of jobs that succeeded when they were tried again."""
        return [
            failure
            for failure, outputs in self._jobs.values()
            if not outputs or not all(output.exists() for output in outputs)
        ]


def write_failures(results: Path, failures: Iterable[FailedJob]) -> None:
    """Write the failures of a run, for `read_failures`."""
    write_manifest(results / FAILED, {"failed": [vars(failure) for failure in failures]})


def clear_failures(results: Path) -> None:
    """Remove the failures of the previous run."""
    (results / FAILED).unlink(missing_ok=True)


def read_failures(results: Path) -> list[FailedJob]:
    """Return the failures of the last run; an empty list if it succeeded."""
    with suppress(StoreError, KeyError, TypeError):
        return [FailedJob(**failure) for failure in read_manifest(results / FAILED)["failed"]]
    return []


def failure_line(failures: list[FailedJob], folder: Path) -> str:
    """Describe failures in a line, each with the path of its log.

    `folder` is the run's folder, relative to the current one.
    """
    descriptions = [
        f"{failure} ({folder / failure.log})" if failure.log else str(failure)
        for failure in failures[:_MAX_NAMED]
    ]
    more = f"; and {len(failures) - _MAX_NAMED} more" if len(failures) > _MAX_NAMED else ""
    return f"failed: {'; '.join(descriptions)}{more}"


@dataclass(frozen=True)
class MissedTarget:
    """Target error that an acquisition missed.

    Attributes
    ----------
    scene, method : str
    error, target : float
        Relative, see `rfpipe.relighting.picture_errors`.
    quantity : str
        Such as "measured error" or "estimated error of indirect light".
    reason : str
        Reason for which the method ended, or "".
    """

    scene: str
    method: str
    error: float
    target: float
    quantity: str
    reason: str

    def __str__(self) -> str:
        reason = f" ({self.reason})" if self.reason else ""
        return (
            f"{self.scene} by {self.method}, {self.quantity} {100 * self.error:.3g} %, "
            f"target {100 * self.target:.3g} %{reason}"
        )


def missed_targets(
    results: Path, acquisitions: Iterable[tuple[str, str]], margin: float
) -> list[MissedTarget]:
    """Return the targets that acquisitions missed, at most one for each acquisition.

    Parameters
    ----------
    results : Path
        Folder of results.
    acquisitions : iterable of (str, str)
        Scene and method; unfinished acquisitions are skipped.
    margin : float
        Factor on a target up to which the error measured by verification pictures meets it. Without
        such pictures, the method's estimate has to meet the target itself.
    """
    missed = []
    for scene, method in acquisitions:
        folder = results / scene / method
        with suppress(StoreError):
            acquired = read_manifest(folder / "transport.json")
            verified = manifest_or_empty(folder / "verification.json")
            missed += _missed(acquired, verified, margin)
    return missed


def _missed(
    acquired: Mapping[str, Any], verified: Mapping[str, Any], margin: float
) -> list[MissedTarget]:
    """Return the first target that an acquisition missed, in a list, or an empty list."""
    measured, estimated = (verified.get("mean_error"), None), last_estimate(acquired["levels"])
    for miss in misses(acquired.get("options", {}), measured, estimated, margin):
        quantity = f"{'estimated' if miss.is_estimate else 'measured'} {miss.quantity}"
        names = acquired["scene"], acquired["method"]
        levels = reversed(acquired["levels"])
        reason = next((row["ended"] for row in levels if "ended" in row), "")
        return [MissedTarget(*names, miss.error, miss.target, quantity, reason)]
    return []
