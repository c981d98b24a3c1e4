"""Work in threads and in dask's workers: equal bytes, also if workers die."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dask
import pytest
from distributed import Client, LocalCluster, Security
from tests.services.waiting import wait_until
from tests.workflow.clusters import address_of, kept_workers
from tests.workflow.harness import TINY, Workflow, undo
from tests.workflow.pieces import Dying, identity, slow
from tests.workflow.stagewise import CAMERA, StagewiseAcquisition, contents, damage, matrix_rig
from tests.workflow.stagewise import SHAPE as STAGED

from rfpipe.errors import ClusterError, IntegrityError
from rfpipe.jobs import workers as cluster_module
from rfpipe.jobs.workers import Resources, connected
from rfpipe.stages import merge as merging
from rfpipe.stages.plan import Plan

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


@pytest.fixture
def captured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StagewiseAcquisition:
    """An acquisition with a captured level of 20 patterns, in runs of two."""
    monkeypatch.setattr(merging, "_CHUNK_BYTES", 1)
    monkeypatch.setattr(merging, "_CHUNKS_PER_FILE", 2)
    acquisition = StagewiseAcquisition(tmp_path / "mine", matrix_rig(noise=CAMERA))
    acquisition.plan = Plan.of("brute_force", "brute_force", (STAGED, STAGED, 1))
    acquisition.schedule(0)
    acquisition.capture(0)
    return acquisition


def test_a_cluster_writes_the_same_bytes_as_threads(
    captured: StagewiseAcquisition, address: str
) -> None:
    level = captured.folder.path / "L00"
    outputs = []
    ways = (
        Resources(), Resources(threads=3), Resources(1e-6, threads=3), Resources(where=address)
    )  # fmt: skip
    for captured.resources in ways:
        captured.merge(0)
        outputs.append({name: contents(level / name) for name in ("merge.zarr", "sums.zarr")})
        outputs[-1]["manifest"] = contents(level / "merge.json")
        merged = captured.folder.store(0, "merge")
        merged.rename(level / f"of {len(outputs)}")  # otherwise it would be reused
    assert outputs[0] == outputs[1] == outputs[2] == outputs[3]
    assert len(outputs[0]["merge.zarr"]) == 10 + 2  # one file per run of patterns


def test_damage_found_by_a_worker_is_reported_by_the_job(
    captured: StagewiseAcquisition, address: str
) -> None:
    captured.resources = Resources(where=address)
    chunk = damage(captured.folder.store(0, "capture"))
    manifest = captured.folder.manifest(0, "capture")
    with pytest.raises(IntegrityError, match=f"{chunk}.*remove {manifest} and run again"):
        captured.merge(0)
    manifest.unlink()
    captured.capture(0)
    captured.merge(0)


def test_only_the_piece_of_a_killed_worker_is_repeated(
    elsewhere: Resources, tmp_path: Path
) -> None:
    with elsewhere.workers(1, tmp_path) as workers:
        parts = list(workers.results(Dying(identity, 3, tmp_path / "died"), PIECES))
    assert [part[1:] for part in parts] == PIECES
    assert os.getpid() not in {part[0] for part in parts}


def test_workers_without_access_to_the_folder_are_refused(address: str) -> None:
    with pytest.raises(ClusterError, match=r"tcp://.* does not see /not/here.*Mount"):
        connected(address, Path("/not/here")).__enter__()


def test_workers_with_another_rfpipe_are_refused(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "_our_code", lambda: "another")
    with pytest.raises(ClusterError, match="runs another version of rfpipe"):
        connected(address, tmp_path).__enter__()


def test_work_that_kills_its_worker_is_reported(tmp_path: Path) -> None:
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        LocalCluster(1, threads_per_worker=1, dashboard_address=":0") as cluster,
        pytest.raises(ClusterError, match=r"the work was lost.*too little memory"),
        Resources(where=cluster.scheduler_address).workers(1, tmp_path) as workers,
    ):
        list(workers.results(lambda _first, _last: os._exit(1), PIECES))


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler and a worker, started like a user starts them."""
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
            promise = workers.hand_out(slow)(0, 1)
            process.kill()
            promise.result()

    with pytest.raises(ClusterError, match=r"(?s)the work was lost.*Finished work is kept"):
        interrupted()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """dask's settings with one certificate for all processes."""
    file = tmp_path_factory.mktemp("tls") / "dask.pem"
    security = Security.temporary()
    file.write_text(f"{security.tls_client_key}\n{security.tls_client_cert}")
    names = ("ca-file", *(f"{role}.{part}" for role in ROLES for part in ("key", "cert")))
    return {f"distributed.comm.tls.{name}": str(file) for name in names}


ROLES = ("client", "scheduler", "worker")


def test_a_cluster_over_tls_with_the_certificates_of_dasks_settings(
    certificates: dict[str, str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with dask.config.set(certificates):
        security = Security(require_encryption=True)
        with (
            LocalCluster(1, threads_per_worker=1, processes=False, protocol="tls://",
                         security=security, dashboard_address=None) as cluster,
            connected(cluster.scheduler_address, tmp_path) as (hand_out, threads),
        ):  # fmt: skip
            assert (threads, hand_out(identity)(2, 3).result()[1:]) == (1, (2, 3))
            address = cluster.scheduler_address
    assert "not encrypted" not in caplog.text
    with pytest.raises(ClusterError, match=r"docs/parallel.*certificates for tls"):
        connected(address, tmp_path).__enter__()


def test_plain_tcp_to_another_machine_gives_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster_module, "_PATIENCE_SECONDS", 0.1)
    for host, is_warned in (("192.0.2.1", True), ("127.0.0.1", False), ("localhost", False)):
        caplog.clear()
        with pytest.raises(ClusterError, match="no scheduler with workers"):
            connected(f"tcp://{host}:9", tmp_path).__enter__()
        assert ("dask unpickles what it receives" in caplog.text) == is_warned, host


@pytest.mark.slow
def test_a_run_uses_a_cluster(copy: Workflow, undisturbed: Workflow, address: str) -> None:
    undo(copy, 3, "merge")
    copy.configure(resources={"workers": address})
    copy.run(TINY)
    assert copy.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
