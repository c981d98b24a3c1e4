"""Work by threads and dask's workers: the same bytes, whoever dies meanwhile."""

from __future__ import annotations

import errno
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from distributed import Client, LocalCluster
from tests.waiting import wait_until
from tests.workflow.clusters import address_of, kept_workers
from tests.workflow.pieces import (
    SHAPE,
    Dying,
    LocalError,
    Noise,
    fails,
    identity,
    identity_of,
    slow,
)
from tests.workflow.stagewise import contents

from rfpipe import OperatorRig, acquire
from rfpipe.errors import ClusterError, ConfigError, DamagedStageError, InputError, StoreError
from rfpipe.export import relit_files
from rfpipe.provenance import generator
from rfpipe.stages.evaluating.evaluate import errors_table
from rfpipe.stages.jobs import cluster as cluster_module
from rfpipe.stages.jobs import sent as sent_module
from rfpipe.stages.jobs.job import stage_log
from rfpipe.stages.jobs.workers import Resources, Workers
from rfpipe.stages.results import write_bundle
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


@pytest.fixture
def elsewhere(address: str) -> Resources:
    return Resources(threads=2, where=address)


def all_ways(address: str) -> list[Resources]:
    places = [(1, "threads"), (2, "threads"), (2, address)]
    return [Resources(threads=count, where=where) for count, where in places]


def dying_once(monkeypatch: pytest.MonkeyPatch, at: int, flag: Path) -> None:
    """Let whoever comes to a piece first die there."""
    really = Workers.results

    def dying(self: Workers, work: Any, pieces: Any) -> Any:
        return really(self, Dying(work, at, flag), pieces)

    monkeypatch.setattr(Workers, "results", dying)


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
    assert left[0] == left[1] == left[2]
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
    manifests = []
    for n in range(3):
        images = generator(n).random((2, *SHAPE, 3), np.float32)
        facts = {"scene": f"s{n}", "method": "m", "names": ["a", "b"], "coaxial": True}
        manifests.append(tmp_path / str(n) / "relight.json")
        arrays = {"relit": images * np.float32(1.1), "truth": images, "patterns": images[..., 0]}
        write_bundle(manifests[-1], "", {**arrays, "floodlit_truth": images[0]}, facts)

    def tables(way: Resources) -> str:
        return errors_table(manifests, way).to_csv()

    here = tables(Resources())
    assert here.count("\n") == 6 + 1
    assert tables(Resources(threads=2)) == here
    dying_once(monkeypatch, 1, tmp_path / "died")
    assert tables(Resources(where=address)) == here
    assert (tmp_path / "died").exists()


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


def test_a_worker_that_dies_costs_its_piece(elsewhere: Resources, tmp_path: Path) -> None:
    with elsewhere.workers(1, tmp_path) as workers:
        found = list(workers.results(Dying(identity, 3, tmp_path / "died"), PIECES))
    assert [part[1:] for part in found] == PIECES
    assert os.getpid() not in {part[0] for part in found}
    assert [path.name for path in tmp_path.iterdir()] == ["died"]  # no work is left


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


def test_a_scheduler_that_dies_ends_the_job(
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


def job(**resources: Any) -> Any:
    return SimpleNamespace(
        resources=SimpleNamespace(get=resources.get, keys=resources.keys, **resources), threads=3
    )


def test_a_job_works_where_settings_or_the_environment_say(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("RFPIPE_WORKERS", raising=False)
    assert Resources.of_job(job(mem_mib=512)) == Resources(0.5, 3, "threads")
    asked = job(mem_mib=512, workers="tls://host:8786")
    assert Resources.of_job(asked) == Resources(0.5, 3, "tls://host:8786")
    monkeypatch.setenv("RFPIPE_WORKERS", "tcp://host:8786")
    assert Resources.of_job(asked) == Resources(0.5, 3, "tcp://host:8786")
    assert Resources.of_job(asked).here == Resources(0.5, 3)
    monkeypatch.setenv("RFPIPE_WORKERS", "everywhere")
    with pytest.raises(ConfigError, match=r"RFPIPE_WORKERS is 'everywhere'.*tls://host:8786"):
        Resources.of_job(asked)
