"""Jobs that failed on other machines are told of where Snakemake runs, quiet as it is."""

import logging
from pathlib import Path
from typing import Any

import pytest
from snakemake_interface_logger_plugins.common import LogEvent

from rfpipe.stages.jobs.failures import FailedJobs

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
    said = failed(told, LogEvent.JOB_ERROR, **of_job(SUFFIX, "14", log=["nothing.log"]))
    assert said.splitlines() == [
        "rfpipe: acquire failed as job 14",
        "    glass/dual/L00/capture: level 0: 16 patterns",
        "    ValueError: the glass broke",
        "    (.snakemake/cluster_logs/acquire-14.log)",
    ]


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
    assert "run again without groups to see why" in said


def test_a_job_that_left_no_log_may_not_see_the_folder(told: list[str]) -> None:
    said = failed(told, LogEvent.JOB_ERROR, **of_job(SUFFIX, "10", log=["nothing.log"]))
    assert "does its machine see this folder" in said
