"""Notification, listed changes and reruns in Snakemake; the record of a run."""

from __future__ import annotations

import logging
import shlex
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake.api import Workflow  # first, else snakemake.workflow imports itself

from rfpipe.jobs import snakemake as snakemake_jobs
from rfpipe.jobs.snakemake import explain_reruns, notify
from rfpipe.storage.run_record import rerun_command, write_run_record


@pytest.mark.parametrize(
    "command",
    [
        "/no/such/program",
        shlex.join([sys.executable, "-c", "raise SystemExit(3)"]),
        shlex.join([sys.executable, "-c", "import time; time.sleep(60)"]),
        "an open 'quote",
    ],
)
def test_a_failing_notification_is_only_reported(
    command: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(snakemake_jobs, "_PATIENCE_SECONDS", 0.5)
    notify(command, "done", "log")
    assert f"notify: {command!r} failed" in capfd.readouterr().err


def test_the_notification_has_the_status_of_the_run(tmp_path: Path) -> None:
    code = "import os, sys; open(sys.argv[1], 'w').write(os.environ['RFPIPE_STATUS'])"
    notify(shlex.join([sys.executable, "-c", code, str(tmp_path / "status")]), "failed", "log")
    assert (tmp_path / "status").read_text() == "failed"
    notify(None, "done", "log")


def test_a_copied_run_runs_again_with_its_own_settings(tmp_path: Path) -> None:
    run, copy = tmp_path / "run", tmp_path / "a copy"
    (run / "results").mkdir(parents=True)
    files = [run / "mine.yaml", run / "more" / "mine.yaml", tmp_path / "lab.yaml"]
    write_run_record(run / "results", tmp_path / "Snakefile", files, {"seed": 3})
    shutil.copytree(run, copy)
    for folder in (run, copy):
        command = shlex.split(rerun_command(folder / "results"))
        assert command[1:] == [
            "run", "--directory", f"{folder}", "--snakefile", f"{tmp_path}/Snakefile",
            "--configfile", f"{folder}/mine.yaml", f"{folder}/more/mine.yaml",
            f"{tmp_path}/lab.yaml", "--config", "seed=3",
        ]  # fmt: skip


def test_outputs_of_unchanged_parameters_are_not_listed() -> None:
    from snakemake.persistence import NO_PARAMS_CHANGE, ParamsChange

    snakemake_jobs.list_changed_parameters_alone()
    same = ParamsChange(files={"a.json"})
    changed = ParamsChange(only_new={"2"}, only_old={"1"}, files={"b.json"})
    assert list(NO_PARAMS_CHANGE | same) == []
    assert list(NO_PARAMS_CHANGE | same | changed) == ["b.json"]


@pytest.mark.parametrize("is_triggered", [True, False])
def test_reruns_are_explained_without_advice_to_keep_results_of_other_settings(
    is_triggered: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(Workflow, "log_provenance_info", Workflow.log_provenance_info)
    explain_reruns()
    reason = SimpleNamespace(is_provenance_triggered=lambda: is_triggered)
    dag = SimpleNamespace(needrun_jobs=lambda exclude_finished: ["job"], reason=lambda job: reason)
    with caplog.at_level(logging.INFO):
        Workflow.log_provenance_info(SimpleNamespace(dag=dag))
    assert ("config/README.md" in caplog.text) == is_triggered
    assert "mtime" not in caplog.text
    assert "cleanup-metadata" not in caplog.text
