"""Telling somebody that a run has ended, whichever way."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest
from tests.workflow.harness import TINY, Workflow, undo

from rfpipe.stages.jobs import notify


def writer(told: Path) -> str:
    """A command that writes down what it is told."""
    code = (
        "import os, pathlib, sys; pathlib.Path(sys.argv[1]).write_text("
        "os.environ['RFPIPE_STATUS'] + ' ' + str(os.path.exists(os.environ['RFPIPE_LOG'])))"
    )
    return shlex.join([sys.executable, "-c", code, str(told)])


@pytest.mark.slow
def test_a_run_tells_when_it_is_done_and_when_it_failed(copy: Workflow) -> None:
    told = copy.folder / "told by a run"
    copy.configure(notify=writer(told))
    undo(copy, 3, "refine")
    copy.run(TINY)
    assert told.read_text() == "done True"
    undo(copy, 3, "merge")
    (copy.path("tiny/symmetric/L03/capture.zarr") / "c.1.0.0.0.0").unlink()
    copy.run(TINY, succeeds=False)
    assert told.read_text() == "failed True"


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
    monkeypatch.setattr(notify, "_PATIENCE_SECONDS", 0.5)
    assert not notify.notify(command, "done", "log")
    assert f"notify: {command!r} failed" in capfd.readouterr().err


def test_without_a_command_nobody_is_told() -> None:
    assert not notify.notify(None, "done", "log")
