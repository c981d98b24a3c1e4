"""Scripts in processes forked from one that has loaded their libraries."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from snakemake.benchmark import BenchmarkRecord
from tests.services.waiting import wait_until

from rfpipe.jobs.forked_scripts import ForkServers


class Scripts:
    """Scripts run by a fork server with two threads."""

    def __init__(self) -> None:
        self.servers = ForkServers()
        self.folder = Path()

    def run(self, code: str, **attributes: Any) -> str:
        """Run code that may write to `output`; return what it wrote."""
        output = self.folder / "output"
        file = self.folder / "script.py"
        file.write_text(f"import os, sys\noutput = open({str(output)!r}, 'w')\n{code}\n")
        script = {"threads": 2, "resources": {}, "bench_record": None, **attributes}
        self.servers.execute(SimpleNamespace(**script), str(file))
        return output.read_text()


@pytest.fixture(scope="module")
def started() -> Iterator[Scripts]:
    scripts = Scripts()
    yield scripts
    scripts.servers.close()


@pytest.fixture
def scripts(started: Scripts, tmp_path: Path) -> Scripts:
    started.folder = tmp_path
    return started


def test_a_script_has_the_folder_environment_and_threads_of_a_new_process(
    scripts: Scripts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OF_THE_RUN", "later than the server's start")
    monkeypatch.chdir(tmp_path)
    names = ("OF_THE_RUN", "OMP_NUM_THREADS", "TMPDIR")
    code = f"print(os.getcwd(), __name__, *map(os.environ.get, {names}), sep='|', file=output)"
    written = scripts.run(code, resources={"tmpdir": "/var/tmp"})
    assert written == f"{tmp_path}|__main__|later than the server's start|2|/var/tmp\n"


def test_numba_has_the_threads_of_the_job(scripts: Scripts) -> None:
    code = "import numba; print(numba.config.NUMBA_NUM_THREADS, file=output)"
    assert scripts.run(code) == "2\n"


def test_libraries_are_loaded_before_the_script(scripts: Scripts) -> None:
    assert scripts.run("print('zarr' in sys.modules, file=output)") == "True\n"


@pytest.mark.parametrize(
    ("end", "status"),
    [
        ("sys.exit(3)", 3),
        ("1 / 0", 1),
        ("os.kill(os.getpid(), 9)", -signal.SIGKILL),
        ("import signal; signal.raise_signal(signal.SIGINT)", -signal.SIGINT),
        ("import signal; signal.raise_signal(signal.SIGTERM)", -signal.SIGTERM),
    ],
)
def test_a_failed_script_raises_its_exit_status(scripts: Scripts, end: str, status: int) -> None:
    with pytest.raises(subprocess.CalledProcessError) as caught:
        scripts.run(end)
    assert caught.value.returncode == status


def test_time_and_memory_are_those_of_the_script(scripts: Scripts) -> None:
    record = BenchmarkRecord()
    scripts.run("data = b'a' * 10**8; import time; time.sleep(0.7)", bench_record=record)
    assert record.running_time > 0.7
    assert record.max_rss > 100


def test_a_killed_server_is_started_again(scripts: Scripts) -> None:
    server = int(scripts.run("print(os.getppid(), file=output)"))
    os.kill(server, signal.SIGKILL)
    os.waitpid(server, 0)
    assert int(scripts.run("print(os.getppid(), file=output)")) != server


def test_the_server_ignores_signals_and_ends_with_the_run(tmp_path: Path) -> None:
    code = (
        "import sys; from tests.unit.test_forked_scripts import Scripts; scripts = Scripts(); "
        "from pathlib import Path; scripts.folder = Path(sys.argv[1]); "
        "server = scripts.run('print(os.getppid(), file=output)'); "
        "import os, signal; [os.kill(int(server), it) for it in (signal.SIGINT, signal.SIGTERM)]; "
        "assert scripts.run('print(os.getppid(), file=output)') == server; print(server)"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True
    )
    server = Path("/proc", ended.stdout.strip())
    wait_until(lambda: not server.exists() or "Z" in (server / "stat").read_text(), "its end")
