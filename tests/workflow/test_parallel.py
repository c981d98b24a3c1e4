"""Work by threads, processes and dask's workers: the same bytes, whoever dies meanwhile."""

from __future__ import annotations

import errno
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import psutil
import pytest
import yaml
from distributed import Client, LocalCluster
from rfpipe.stages.acquisitions import acquire_all
from tests.waiting import wait_until
from tests.workflow.clusters import address_of, kept_workers
from tests.workflow.pieces import (
    SHAPE,
    Dying,
    FirstLast,
    LocalError,
    Noise,
    deadly,
    fails,
    identity,
    identity_of,
    slow,
)
from tests.workflow.stagewise import contents

from rfpipe import OperatorRig, acquire
from rfpipe.config import parse_config
from rfpipe.errors import ClusterError, ConfigError, DamagedStageError, InputError, StoreError
from rfpipe.export import relit_files
from rfpipe.provenance import generator
from rfpipe.report.catalogue.items import item_of
from rfpipe.stages.evaluating.evaluate import errors_table, speed_error_table
from rfpipe.stages.jobs import cluster as cluster_module
from rfpipe.stages.jobs import sent as sent_module
from rfpipe.stages.jobs import workers as workers_module
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.workers import Resources, Workers
from rfpipe.stages.results import write_bundle
from rfpipe.store import StoreLock
from rfpipe.transport import save_transport

PIECES = [(index, index + 1) for index in range(6)]


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with (
        kept_workers(),
        LocalCluster(2, threads_per_worker=1, dashboard_address=":0") as cluster,
    ):
        yield cluster


@pytest.fixture
def address(cluster: LocalCluster) -> str:
    return address_of(cluster)


@pytest.fixture(params=["processes", "dask"])
def elsewhere(request: pytest.FixtureRequest, address: str) -> Resources:
    where = address if request.param == "dask" else request.param
    return Resources(threads=2, where=where)


def all_ways(address: str) -> list[Resources]:
    places = [(1, "threads"), (2, "threads"), (2, "processes"), (2, address)]
    return [Resources(threads=count, where=where) for count, where in places]


def dying_once(monkeypatch: pytest.MonkeyPatch, at: int, flag: Path) -> None:
    """Let whoever comes to a piece first die there."""
    for name in ("results", "as_done"):
        really = getattr(Workers, name)

        def dying(self: Workers, work: Any, pieces: Any, really: Any = really) -> Any:
            return really(self, Dying(work, at, flag), pieces)

        monkeypatch.setattr(workers_module.Workers, name, dying)


@pytest.fixture(scope="module")
def transport(tmp_path_factory: pytest.TempPathFactory) -> Path:
    matrix = generator(3).random((80, 80))
    rig = OperatorRig(matrix + matrix.T, camera_shape=SHAPE, projector_shape=SHAPE)
    path = tmp_path_factory.mktemp("transport") / "transport.zarr"
    save_transport(acquire(rig, "symmetric", progress=False).transport, path, "uint8")
    return path


# one more than two batches; white light, then coloured
LIGHTS = [*(Noise(n) for n in range(20)), *(Noise(n, (*SHAPE, 1)) for n in range(20, 33))]


def relit(transport: Path, folder: Path, resources: Resources) -> dict[str, bytes]:
    relit_files(transport, LIGHTS, folder, form="png", resources=resources)
    return contents(folder)


def test_pictures_are_relit_to_the_same_bytes(
    transport: Path, tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ways = all_ways(address)
    left = [relit(transport, tmp_path / str(n), way) for n, way in enumerate(ways)]
    assert len(left[0]) == 33
    assert left[0] == left[1] == left[2] == left[3]
    dying_once(monkeypatch, 16, tmp_path / "died")
    assert relit(transport, tmp_path / "again", ways[-1]) == left[0]
    assert (tmp_path / "died").exists()


def test_two_patterns_of_one_name_are_refused(transport: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two patterns are named noise_01"):
        relit_files(transport, [Noise(1), Noise(1)], tmp_path / "pictures")
    assert not (tmp_path / "pictures").exists()


def test_errors_are_the_same_numbers(
    tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    manifests, sweeps = [], []
    for n in range(3):
        images = generator(n).random((2, *SHAPE, 3), np.float32)
        facts = {"scene": f"s{n}", "method": "m", "names": ["a", "b"], "coaxial": True}
        manifests.append(tmp_path / str(n) / "relight.json")
        arrays = {"relit": images * np.float32(1.1), "truth": images, "patterns": images[..., 0]}
        write_bundle(manifests[-1], "", {**arrays, "floodlit_truth": images[0]}, facts)
        sweeps.append(tmp_path / str(n) / "sweep.json")
        rows = [{"option": "o", "value": 1, "patterns": 9, "bytes": 5}]
        write_bundle(sweeps[-1], "", {"relit": images[None]}, {**facts, "rows": rows})
        sweeps[-1].with_suffix(".csv").write_text("value,processing_s,simulation_s\n1,2,3\n")

    def tables(way: Resources) -> str:
        errors = errors_table(manifests, way).to_csv()
        return errors + speed_error_table(manifests, sweeps, 2.0, way).to_csv()

    here = tables(Resources())
    assert here.count("\n") == 6 + 6 + 2
    assert tables(Resources(threads=2)) == here
    # a process takes seconds to load the library of colours
    with_processes = errors_table(manifests, Resources(threads=2, where="processes"))
    assert here.startswith(with_processes.to_csv())
    dying_once(monkeypatch, 1, tmp_path / "died")
    assert tables(Resources(where=address)) == here
    assert (tmp_path / "died").exists()


SCENES = parse_config(
    {
        "scenes": {
            name: {"kind": "plane", "surfaces": [name], "shape": [6, 8], "channels": 1}
            for name in ("white", "texture")
        },
        "methods": {"brute_force": {}},
    },
    "the test",
)


def acquired(path: Path, way: Resources) -> dict[str, bytes]:
    assert [one.error for one in acquire_all(SCENES, path, way)] == [None, None]
    files = contents(path)
    return {name: files[name] for name in files if not name.endswith((".log", ".tsv"))}


def test_scenes_are_acquired_to_the_same_bytes(
    tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = [acquired(tmp_path / str(n), way) for n, way in enumerate(all_ways(address)[1:])]
    assert sum(name.endswith("transport.json") for name in left[0]) == 2
    assert left[0] == left[1] == left[2]
    dying_once(monkeypatch, 1, tmp_path / "died")
    assert acquired(tmp_path / "again", Resources(where=address)) == left[0]
    assert (tmp_path / "died").exists()


def test_workers_find_files_where_the_settings_mean_them(
    tmp_path: Path, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where none of the workers was started
    np.save("known.npy", np.eye(48))
    scene = {"kind": "matrix", "file": "known.npy", "shape": [6, 8], "channels": 1}
    settings = parse_config({"scenes": {"a": scene}, "methods": {"hadamard": {}}}, "the test")
    found = acquire_all(settings, Path("results"), Resources(where=address))
    assert [one.error for one in found] == [None]
    assert (tmp_path / "results/a/hadamard/transport.json").exists()


def test_a_scene_that_fails_does_not_end_the_others(tmp_path: Path) -> None:
    log = tmp_path / "white/brute_force/acquire.log"
    log.parent.mkdir(parents=True)
    log.write_text("of the one that has it")
    with StoreLock(log.parent):
        found = acquire_all(SCENES, tmp_path, Resources())
    assert [one.scene for one in found if one.error] == ["white"]
    assert "is writing this store" in str(found[0].error)
    assert log.read_text() == "of the one that has it"
    assert (tmp_path / "texture/brute_force/transport.json").exists()


def test_each_has_the_memory_of_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[tuple[str, float]] = []

    def run(
        plan: object, folder: object, scene: str, *_: object, resources: Resources, **__: Any
    ) -> None:
        found.append((scene, resources.memory_gib))

    monkeypatch.setattr("rfpipe.stages.acquisitions.levels.run", run)
    plane = {"kind": "plane", "surfaces": ["white"], "shape": [6, 8], "channels": 1}
    own = {**plane, "settings": {"resources": {"memory_gib": 0.5}}}
    settings = {"scenes": {"a": plane, "b": own}, "methods": {"hadamard": {}}}
    acquire_all(parse_config({**settings, "resources": {"memory_gib": 2}}, "the test"), tmp_path,
                Resources())  # fmt: skip
    assert found == [("a", 2.0), ("b", 0.5)]


OWN = """\
from tests.examples.frosted_glass import FrostedGlass

class Broken(FrostedGlass):
    def apply(self, patterns):
        raise KeyError("lens")
"""


def test_a_folder_that_can_t_be_made_does_not_end_the_others(tmp_path: Path) -> None:
    (tmp_path / "white").write_text("in the way")
    found = acquire_all(SCENES, tmp_path, Resources())
    assert [one.scene for one in found if one.error] == ["white"]
    assert (tmp_path / "texture/brute_force/transport.json").exists()


def test_a_log_that_can_t_be_written_is_done_without(capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("rfpipe")
    with stage_log(Path("/dev/full")):
        log.warning("for the file")
    assert "No space left" not in capsys.readouterr().err


def test_work_that_can_t_be_written_is_refused_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("rfpipe.store.files.os.replace", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)  # on such a file system, of what isn't there, too
    with (
        pytest.raises(StoreError, match="expected a place that this user may write to"),
        sent_module.sending(tmp_path) as send,
    ):
        send(identity)


ACQUIRE_BY_TWO = """\
import os, sys
os.sched_getaffinity = lambda _: {0, 1}
sys.argv = ["rfpipe", "acquire", "run.yaml"]
from rfpipe.cli import main
main()
"""


def test_a_bug_of_an_own_scene_does_not_end_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN)
    rays = {"shape": [6, 8], "channels": 1}
    scenes = {
        "own": {"kind": "own.py:Broken", **rays},
        "sound": {"kind": "plane", "surfaces": ["white"], **rays},
    }
    settings = parse_config({"scenes": scenes, "methods": {"hadamard": {}}}, "the test")
    found = acquire_all(settings, Path("results"), Resources())
    assert [one.error for one in found] == ["KeyError: 'lens'", None]
    item = item_of(Path("results/own/hadamard"))
    assert (item.state, item.why) == ("failed", "KeyError: 'lens'")


WAITING = """\
import time
from pathlib import Path
from tests.examples.frosted_glass import FrostedGlass

class Waiting(FrostedGlass):
    def apply(self, patterns):
        Path("began").touch()
        while not Path("go_on").exists():
            time.sleep(0.01)
        return super().apply(patterns)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_stopped_says_so_and_leaves_nothing_behind(
    tmp_path: Path, number: signal.Signals
) -> None:
    (tmp_path / "own.py").write_text(WAITING)
    own = {"kind": "own.py:Waiting", "shape": [6, 8], "channels": 1}
    settings = {"scenes": {"own": own}, "methods": {"hadamard": {}}}
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(settings))
    # also on a machine of one core
    command = [sys.executable, "-c", ACQUIRE_BY_TWO]
    search = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    with subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "PYTHONPATH": search},
    ) as process:  # fmt: skip
        wait_until((tmp_path / "began").exists, "a capture")
        process.send_signal(number)
        said = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "rfpipe: stopped; what is done is kept" in said
    assert list((tmp_path / "results").glob(".work*")) == []
    with StoreLock(tmp_path / "results/own/hadamard"):  # nobody works on it any more
        pass


def test_a_rig_is_where_it_is(tmp_path: Path) -> None:
    settings = SCENES.model_copy(
        update={"capture": SCENES.capture.model_copy(update={"rig": "hardware"})}
    )
    with pytest.raises(InputError, match=r"capture.rig is hardware.*where the rig is"):
        acquire_all(settings, tmp_path, Resources())


def test_a_long_piece_holds_up_no_other(elsewhere: Resources, tmp_path: Path) -> None:
    died, got_others = tmp_path / "died", tmp_path / "got others"
    found = []
    with elsewhere.workers(1, tmp_path) as workers:
        for first in workers.as_done(Dying(FirstLast(got_others), 3, died), PIECES):
            found.append(first)
            if len(found) == len(PIECES) - 1:
                got_others.touch()
    assert found[-1] == 0
    assert sorted(found) == [first for first, _ in PIECES]
    assert died.exists()


def test_a_process_that_dies_costs_its_piece(elsewhere: Resources, tmp_path: Path) -> None:
    with elsewhere.workers(1, tmp_path) as workers:
        found = list(workers.results(Dying(identity, 3, tmp_path / "died"), PIECES))
    assert [part[1:] for part in found] == PIECES
    assert os.getpid() not in {part[0] for part in found}
    assert [path.name for path in tmp_path.iterdir()] == ["died"]  # no work is left


def test_a_piece_that_kills_every_process_is_given_up(tmp_path: Path) -> None:
    with (
        pytest.raises(ClusterError, match=r"processes died 4 times.* 3 to 3.*too little memory"),
        Resources(threads=2, where="processes").workers(1, tmp_path) as workers,
    ):
        list(workers.results(deadly, PIECES))


def test_errors_come_back_as_they_are(elsewhere: Resources, tmp_path: Path) -> None:
    with (
        pytest.raises(DamagedStageError, match="a stage is damaged") as damaged,
        elsewhere.workers(1, tmp_path) as workers,
    ):
        list(workers.results(fails, PIECES))
    assert damaged.value.manifest == Path("L01/merge.json")
    with (
        # dask teaches a worker that met an error once to send it as it is
        pytest.raises((RuntimeError, LocalError), match="this and that"),
        elsewhere.workers(1, tmp_path) as workers,
    ):
        list(workers.results(fails, PIECES[2:]))


def test_processes_end_with_an_interrupt(tmp_path: Path) -> None:
    before = set(psutil.Process().children())
    began = time.monotonic()

    def interrupted() -> None:
        with Resources(threads=2, where="processes").workers(1, tmp_path) as workers:
            assert workers.hand_out is not None
            workers.hand_out(slow)(0, 1)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    _, alive = psutil.wait_procs(set(psutil.Process().children()) - before, timeout=60)
    running = [child for child in alive if "resource_tracker" not in " ".join(child.cmdline())]
    assert not running
    assert time.monotonic() - began < 250


def test_a_script_without_a_guard_has_processes_and_takes_them_along(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys, time\n"
        "from pathlib import Path\n"
        "from rfpipe.stages.jobs.workers import Resources\n"
        "from tests.workflow.pieces import identity\n"
        "with Resources(threads=2, where='processes').workers(1, Path('.')) as workers:\n"
        "    found = list(workers.results(identity, [(0, 1), (1, 2)]))\n"
        "    print(*{pid for pid, _, _ in found}, flush=True)\n"
        "    os.kill(os.getpid(), 9)\n"
    )
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )  # fmt: skip
    assert done.returncode == -signal.SIGKILL, done.stderr
    pids = [int(pid) for pid in done.stdout.split()]
    assert pids
    wait_until(lambda: not any(psutil.pid_exists(pid) for pid in pids), "the end of the processes")


def test_workers_that_do_not_see_the_folder_are_refused(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def lost(path: Path, content: bytes) -> None:
        """Write where nobody else sees it."""

    monkeypatch.setattr(sent_module, "write_atomically", lost)
    with (
        pytest.raises(ClusterError, match=rf"tcp://.* does not see {tmp_path}.*Mount"),
        Resources(where=address).workers(1, tmp_path) as workers,
    ):
        list(workers.results(identity, PIECES))


def test_workers_with_another_rfpipe_or_none_are_refused(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def handed_out() -> None:
        with Resources(where=address).workers(1, tmp_path) as workers:
            list(workers.results(identity, PIECES))

    with monkeypatch.context() as patch:
        patch.setattr(sent_module, "_our_code", lambda: "another")
        with pytest.raises(ClusterError, match="runs another version of rfpipe"):
            handed_out()
    name = "rfpipe.stages.jobs.sent"

    def hide() -> None:
        sys.modules["hidden"], sys.modules[name] = sys.modules[name], None  # type: ignore[assignment]

    def show() -> None:
        sys.modules[name] = sys.modules.pop("hidden")

    handed_out()
    with Client(address, set_as_default=False) as client:
        client.run(hide)
        with pytest.raises(ClusterError, match="can't load this version of rfpipe"):
            handed_out()
        client.run(show)
    handed_out()


def test_without_workers_it_does_not_wait_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "_LOOK_SECONDS", 0.1)
    monkeypatch.setattr(cluster_module, "_WITHOUT_WORKERS_SECONDS", 0.5)

    def left_alone(cluster: Any) -> None:
        with Resources(where=cluster.scheduler_address).workers(1, tmp_path) as workers:
            assert workers.hand_out is not None
            ask = workers.hand_out(identity)
            assert ask(0, 1).result()[1:] == (0, 1)
            cluster.scale(0)
            wait_until(lambda: not cluster.scheduler.workers, "the worker's end")
            ask(1, 2).result()

    with (
        LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster,
        pytest.raises(ClusterError, match=r"all workers are gone.*dask worker inproc"),
    ):
        left_alone(cluster)


def test_workers_within_this_process_leave_it_its_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba refuses another number in the environment at the next kernel that it compiles."""
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    numba.set_num_threads(numba.get_num_threads())  # which starts them
    with (
        LocalCluster(1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster,
        Resources(where=cluster.scheduler_address).workers(1, tmp_path) as workers,
    ):
        assert workers.hand_out is not None
        assert workers.hand_out(identity)(0, 1).result()[0] == os.getpid()
    assert numba.njit(identity_of)(3) == 3


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler and a worker, as a user starts them."""
    file = tmp_path / "scheduler.json"
    dask = [sys.executable, "-m", "distributed.cli"]
    options = ["--scheduler-file", str(file), "--no-dashboard"]
    serves = subprocess.Popen([f"{dask[0]}", "-m", "distributed.cli.dask_scheduler", "--port", "0",
                               "--host", "127.0.0.1", *options])  # fmt: skip
    works = subprocess.Popen([dask[0], "-m", "distributed.cli.dask_worker", "--nthreads", "1",
                              "--death-timeout", "20", *options])  # fmt: skip
    try:
        wait_until(file.exists, "the scheduler")
        with Client(scheduler_file=str(file), set_as_default=False) as client:
            client.wait_for_workers(1, timeout=60)
            address = client.scheduler.address
        yield serves, address
    finally:
        for process in (serves, works):
            process.kill()
            process.wait()


def test_a_scheduler_that_dies_ends_the_job_and_the_next_goes_on(
    scheduler: tuple[subprocess.Popen[bytes], str], tmp_path: Path
) -> None:
    process, address = scheduler

    def interrupted() -> None:
        with Resources(where=address).workers(1, tmp_path) as workers:
            assert workers.hand_out is not None
            promise = workers.hand_out(slow)(0, 1)
            process.kill()
            promise.result()

    with pytest.raises(ClusterError, match=r"the scheduler is gone.*What is done is kept"):
        interrupted()
    # whatever was cut off goes on without it, here before its first pattern
    assert acquired(tmp_path / "results", Resources())


def job(**resources: Any) -> Any:
    return SimpleNamespace(
        resources=SimpleNamespace(get=resources.get, keys=resources.keys, **resources), threads=3
    )


def test_a_job_works_where_settings_or_the_environment_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("RFPIPE_WORKERS", raising=False)
    assert Resources.of_job(job(mem_mib=512)) == Resources(0.5, 3, "threads")
    asked = job(mem_mib=512, workers="processes")
    assert Resources.of_job(asked) == Resources(0.5, 3, "processes")
    monkeypatch.setenv("RFPIPE_WORKERS", "tcp://host:8786")
    assert Resources.of_job(asked) == Resources(0.5, 3, "tcp://host:8786")
    assert Resources.of_job(asked).here == Resources(0.5, 3)
    monkeypatch.setenv("RFPIPE_WORKERS", "everywhere")
    with pytest.raises(ConfigError, match=r"RFPIPE_WORKERS is 'everywhere'.*tls://host:8786"):
        Resources.of_job(asked)
