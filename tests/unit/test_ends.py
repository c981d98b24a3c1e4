"""Where Snakemake runs: jobs that failed elsewhere, and a run's end."""

from __future__ import annotations

import logging
import shlex
import sys
from pathlib import Path
from typing import Any

import pytest
from snakemake_interface_logger_plugins.common import LogEvent

from rfpipe.stages.jobs import ends
from rfpipe.stages.jobs.ends import FailedJobs, notify

LOG = """
rule acquire:
    output: results/glass/dual/transport.json
    resources: tmpdir=<TBD>, mem_mb=572
glass/dual/L00/capture: level 0: 16 patterns
ValueError: the glass broke
RuleException:
CalledProcessError in file "acquire.smk", line 24:
Command 'set -euo pipefail;  python acquire.py' {ended}
[Mon Nov 23 09:41:42 2026]
Error in rule acquire:
    message: None
Shutting down, this might take some time.
Exiting because a job execution failed. Look above for error messages
WorkflowError:
At least one job did not complete successfully.
"""
SUFFIX = "For further error details see the cluster/cloud log and the log files of the rule."


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    monkeypatch.chdir(tmp_path)
    return []


def failed(told: list[str], event: LogEvent, **facts: Any) -> str:
    """Log as Snakemake does, and return what was told of it."""
    log = logging.getLogger("as snakemake's")
    log.propagate = False
    handler = FailedJobs(told.append)
    log.addHandler(handler)
    log.error("Error in rule", extra={"event": event, "indent": False, **facts})
    log.removeHandler(handler)
    return "\n".join(told)


def of_job(message: str | None = None, number: str | None = None, **facts: Any) -> dict[str, Any]:
    aux = {} if number is None else {"external_jobid": number}
    return {"rule_name": "acquire", "rule_msg": message, "aux": aux, "log": [], **facts}


def test_what_a_scheduler_refuses_is_said_without_its_script(told: list[str]) -> None:
    message = (
        "SLURM sbatch failed. The error message was 'invalid partition specified: nope'.\n"
        f"    sbatch call:\n        sbatch --mem 572\n{SUFFIX}"
    )
    Path("old.log").write_text("of an earlier run\n")
    said = failed(told, LogEvent.JOB_ERROR, **of_job(message, log=["old.log"]))
    assert said == (
        "rfpipe: acquire failed\n"
        "    SLURM sbatch failed. The error message was 'invalid partition specified: nope'."
    )


def test_the_end_of_a_failed_jobs_log_is_told(told: list[str]) -> None:
    logs = Path(".snakemake/cluster_logs")
    logs.mkdir(parents=True)
    (logs / "acquire-14.log").write_text(LOG.format(ended="returned non-zero exit status 1."))
    (logs / "acquire-114.log").write_text("of another job\n")
    said = failed(told, LogEvent.JOB_ERROR, **of_job(None, "14", log=["nothing.log"]))
    assert said.startswith("rfpipe: acquire failed as job 14\n")
    assert "    ValueError: the glass broke\n" in said
    assert said.endswith("    (.snakemake/cluster_logs/acquire-14.log)")


def test_a_job_that_was_killed_says_by_what(told: list[str]) -> None:
    Path("slurm.log").write_text(LOG.format(ended="died with <Signals.SIGKILL: 9>."))
    said = failed(told, LogEvent.JOB_ERROR, **of_job(None, "7", log=["slurm.log"]))
    assert "died with <Signals.SIGKILL: 9>" in said


def test_a_group_is_told_of_once(told: list[str]) -> None:
    Path("group.log").write_text(LOG.format(ended="returned non-zero exit status 1."))
    jobs = [{"rule_name": "relight", "log": []}, {"rule_name": "acquire", "log": []}]
    facts = {"aux_logs": ["group.log"], "job_error_info": jobs}
    assert "a group failed, of acquire, relight\n" in failed(told, LogEvent.GROUP_ERROR, **facts)
    assert "ValueError: the glass broke" in told[0]
    failed(told, LogEvent.JOB_ERROR, **of_job(indent=True))
    failed(told, LogEvent.PROGRESS)
    assert len(told) == 1
    said = failed(told, LogEvent.GROUP_ERROR, aux_logs=[], job_error_info=jobs)
    assert "it left no log" in said


def test_a_job_that_left_no_log_may_not_see_the_folder(told: list[str]) -> None:
    said = failed(told, LogEvent.JOB_ERROR, **of_job(SUFFIX, "10", log=["nothing.log"]))
    assert "does its machine see this folder" in said


@pytest.mark.parametrize(
    "command",
    [
        "/no/such/program",
        shlex.join([sys.executable, "-c", "raise SystemExit(3)"]),
        shlex.join([sys.executable, "-c", "import time; time.sleep(60)"]),
        "an open 'quote",
    ],
)
def test_a_command_that_fails_changes_nothing(
    command: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ends, "_PATIENCE_SECONDS", 0.5)
    notify(command, "done", "log")
    assert f"notify: {command!r} failed" in capfd.readouterr().err


def test_the_command_knows_how_the_run_ended(tmp_path: Path) -> None:
    code = "import os, sys; open(sys.argv[1], 'w').write(os.environ['RFPIPE_STATUS'])"
    notify(shlex.join([sys.executable, "-c", code, str(tmp_path / "told")]), "failed", "log")
    assert (tmp_path / "told").read_text() == "failed"
    notify(None, "done", "log")
