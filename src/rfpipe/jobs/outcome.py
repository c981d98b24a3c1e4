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
"""Lies in ``results`` after a run of which jobs failed."""

_LEVEL = "L"
_NAMED = 4  # failures that the last line has


@dataclass(frozen=True)
class Failure:
    """A job that failed: its stage, and its log relative to the run's folder.

    `scene`, `method` and `level` are empty where the job is of none.
    """

    stage: str
    log: str
    scene: str = ""
    method: str = ""
    level: str = ""

    @classmethod
    def of_log(cls, stage: str, log: str) -> Failure:
        """Return the failure of a job by its rule and its log, results/{scene}/{method}/..."""
        folders = Path(log).parts[1:-1]
        if len(folders) < 2 or folders[0] == "report":
            return cls(stage, log)
        level = folders[2] if len(folders) > 2 else ""
        return cls(Path(log).stem, log, folders[0], folders[1], level)

    def __str__(self) -> str:
        level = f"level {int(self.level[1:])}, " if self.level.startswith(_LEVEL) else ""
        of = f"{self.scene} by {self.method}, {level}" if self.scene else ""
        return f"{of}{self.stage}"


class FailedJobs(logging.Handler):
    """Collects the jobs that Snakemake reports as failed."""

    def __init__(self) -> None:
        super().__init__()
        self._jobs: dict[str, tuple[Failure, list[Path]]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Take the job of a record that is about a failed one."""
        from snakemake_interface_logger_plugins.common import LogEvent

        if getattr(record, "event", None) == LogEvent.JOB_ERROR:
            job: Any = record
            log = str(job.log[0]) if job.log else ""
            outputs = [Path(str(output)) for output in job.output]
            self._jobs[f"{job.rule_name} {log}"] = Failure.of_log(job.rule_name, log), outputs

    def failures(self) -> list[Failure]:
        """Return the failures, except of jobs that succeeded when they were tried again."""
        return [
            failure
            for failure, outputs in self._jobs.values()
            if not outputs or not all(output.exists() for output in outputs)
        ]


def write_failures(results: Path, failures: Iterable[Failure]) -> None:
    """Write the failures of a run, for `read_failures`."""
    write_manifest(results / FAILED, {"failed": [vars(failure) for failure in failures]})


def clear_failures(results: Path) -> None:
    """Remove the failures of the run before."""
    (results / FAILED).unlink(missing_ok=True)


def read_failures(results: Path) -> list[Failure]:
    """Return the failures of the last run; none where it succeeded."""
    with suppress(StoreError, KeyError, TypeError):
        return [Failure(**failure) for failure in read_manifest(results / FAILED)["failed"]]
    return []


def failure_line(failures: list[Failure], folder: Path) -> str:
    """Describe failures in a line, each with its log as seen from where the run was started."""
    named = [
        f"{failure} ({folder / failure.log})" if failure.log else str(failure)
        for failure in failures[:_NAMED]
    ]
    more = f"; and {len(failures) - _NAMED} more" if len(failures) > _NAMED else ""
    return f"failed: {'; '.join(named)}{more}"


@dataclass(frozen=True)
class Missed:
    """An acquisition whose error is above its target.

    Attributes
    ----------
    scene, method : str
    error, target : float
        Relative, see `rfpipe.relighting.picture_errors`.
    quantity : str
        What the error is of, and how it is known.
    why : str
        The method's last warning, or "".
    """

    scene: str
    method: str
    error: float
    target: float
    quantity: str
    why: str

    def __str__(self) -> str:
        why = f" ({self.why})" if self.why else ""
        return (
            f"{self.scene} by {self.method}, {self.quantity} {100 * self.error:.3g} %, "
            f"target {100 * self.target:.3g} %{why}"
        )


def missed_targets(
    results: Path, acquisitions: Iterable[tuple[str, str]], margin: float
) -> list[Missed]:
    """Return the acquisitions that missed their ``target_error`` or ``target_indirect``.

    The error is measured by pictures for verification, up to `margin` times the target, or else the
    method's estimate. Unfinished acquisitions are skipped.
    """
    missed = []
    for scene, method in acquisitions:
        folder = results / scene / method
        with suppress(StoreError):
            acquired = read_manifest(folder / "transport.json")
            verified = manifest_or_empty(folder / "verification.json")
            missed += _missed(acquired, verified, margin, _warnings(folder, acquired))
    return missed


def _missed(
    acquired: Mapping[str, Any], verified: Mapping[str, Any], margin: float, why: str
) -> list[Missed]:
    """Compare the errors of an acquisition with the options of its method; name one at most."""
    measured, estimated = (verified.get("mean_error"), None), last_estimate(acquired["levels"])
    for miss in misses(acquired.get("options", {}), measured, estimated, margin):
        quantity = f"{'estimated' if miss.is_estimate else 'measured'} {miss.quantity}"
        names = acquired["scene"], acquired["method"]
        return [Missed(*names, miss.error, miss.target, quantity, why)]
    return []


def _warnings(folder: Path, acquired: Mapping[str, Any]) -> str:
    """Return the method's last warning, see `rfpipe.stages.refine`."""
    for number, _ in reversed(acquired.get("made_of", {}).get("refine", [])):
        warnings = manifest_or_empty(folder / f"L{number:02d}" / "refine.json").get("warnings")
        if warnings:
            return str(warnings[-1])
    return ""
