"""The lock of a run's folder: removed only if the process that holds it was killed."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.rigs.known_matrix import run as run_command

from rfpipe.errors import LockedError
from rfpipe.jobs.snakemake_lock import free_if_dead, unrecorded
from rfpipe.store import write_manifest

RUN = """
import sys, time
from pathlib import Path
from rfpipe.jobs.snakemake_lock import hold
folder = Path(sys.argv[1])
locks = folder / ".snakemake" / "locks"
locks.mkdir(parents=True, exist_ok=True)
(locks / "0.input.lock").write_text("a")
(locks / "0.output.lock").write_text("b")
hold(folder)
print("held", flush=True)
time.sleep(600)
"""

UNLOCK = "rfpipe run --unlock"


def locks(folder: Path) -> list[Path]:
    return sorted(folder.glob(".snakemake/locks/*"))


@pytest.fixture
def run(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """A process that holds the lock of `tmp_path`."""
    with subprocess.Popen(
        [sys.executable, "-c", RUN, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def kill(run: subprocess.Popen[str]) -> None:
    os.kill(run.pid, signal.SIGKILL)
    run.wait()


def test_a_folder_without_a_lock_is_free(tmp_path: Path) -> None:
    assert not free_if_dead(tmp_path, UNLOCK)


def test_a_killed_run_s_lock_is_removed(tmp_path: Path, run: subprocess.Popen[str]) -> None:
    kill(run)
    assert len(locks(tmp_path)) == 2
    assert free_if_dead(tmp_path, UNLOCK)
    assert not locks(tmp_path)
    assert not free_if_dead(tmp_path, UNLOCK)


def test_a_running_run_keeps_its_lock(tmp_path: Path, run: subprocess.Popen[str]) -> None:
    for unlocking in (UNLOCK, None):  # for both commands
        with pytest.raises(LockedError, match=f"process {run.pid} is running the workflow"):
            free_if_dead(tmp_path, unlocking)
    assert len(locks(tmp_path)) == 2


@pytest.mark.parametrize("change", ["another", "later"])
def test_an_unknown_lock_is_not_removed(
    tmp_path: Path, run: subprocess.Popen[str], change: str
) -> None:
    kill(run)
    folder = tmp_path / ".snakemake" / "locks"
    if change == "another":  # next to the lock files of the killed run
        (folder / "1.output.lock").touch()
    else:  # of a later Snakemake
        (folder / "0.input.lock").unlink()
        (folder / "0.input.lock").touch()
    with pytest.raises(LockedError, match=f"by an unknown Snakemake.*{UNLOCK}"):
        free_if_dead(tmp_path, UNLOCK)
    assert not free_if_dead(tmp_path, None)  # Snakemake removes it
    assert locks(tmp_path)


def test_results_without_snakemake_s_records_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for scene in ("copied", "recorded"):
        write_manifest(Path(f"results/{scene}/dual/transport.json"), {})
    records = Path(".snakemake/metadata")
    records.mkdir(parents=True)
    # Snakemake's record of results/recorded/dual/transport.json
    name = "cmVzdWx0cy9yZWNvcmRlZC9kdWFsL3RyYW5zcG9ydC5qc29u"
    (records / name).write_text("{}")
    assert unrecorded(Path()) == ["copied/dual"]
    monkeypatch.setattr(sys.modules["rfpipe.cli.run"], "_status_of", lambda command: 0)
    output = run_command("run")
    assert "no records of the settings of copied/dual" in output
    assert "--forceall" in output
    assert "no records" not in run_command("run", "--forceall")
    (records / name).unlink()
    assert "and 1 more" in run_command("run")
    shutil.rmtree("results")
    assert "no records" not in run_command("run")
