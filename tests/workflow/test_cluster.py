"""The merge on threads and on a real cluster of two workers: the same bytes."""

from __future__ import annotations

import os
import pickle
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import pytest
from distributed import LocalCluster, Security
from tests.helpers import settings_of_a_plane
from tests.waiting import PATIENCE_SECONDS
from tests.workflow.clusters import address_of, kept_workers
from tests.workflow.harness import TINY, Workflow, undo
from tests.workflow.stagewise import CAMERA, SHAPE, Acquisition, contents, damage, matrix_rig

from rfpipe.errors import CaptureError, ClusterError, ConfigError, IntegrityError
from rfpipe.stages import merge
from rfpipe.stages.jobs import cluster as cluster_module
from rfpipe.stages.jobs.cluster import connected
from rfpipe.stages.jobs.workers import Resources
from rfpipe.stages.merging import merger as merging
from rfpipe.stages.plan import Plan

pytestmark = pytest.mark.slow


def local_cluster(workers: int) -> Any:
    # a worker that dies shall not be tried again
    with dask.config.set({"distributed.scheduler.allowed-failures": 0}):
        return LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=":0"
        )


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with kept_workers(), local_cluster(2) as cluster:
        yield cluster


@pytest.fixture
def address(cluster: Any) -> str:
    return address_of(cluster)


@pytest.fixture
def captured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Acquisition:
    """A level of 20 patterns, two of them in a run."""
    monkeypatch.setattr(merging, "_CHUNK_BYTES", 1)
    monkeypatch.setattr(merging, "_CHUNKS_PER_RUN", 2)
    acquisition = Acquisition(tmp_path / "mine", matrix_rig(noise=CAMERA))
    acquisition.plan = Plan("brute_force", "brute_force", SHAPE, SHAPE, 1)
    acquisition.schedule(0)
    acquisition.capture(0)
    return acquisition


def test_a_cluster_leaves_the_bytes_that_threads_leave(captured: Acquisition, address: str) -> None:
    level = captured.folder.path / "L00"
    left = []
    ways = [(1, "threads"), (2, "threads"), (2, address)]
    for resources in [Resources(threads=count, where=where) for count, where in ways]:
        captured.resources = resources
        captured.merge(0)
        left.append({name: contents(level / name) for name in ("merge.zarr", "sums.zarr")})
        left[-1]["manifest"] = contents(level / "merge.json")
        merged = captured.folder.store(0, "merge")
        merged.rename(level / f"of {len(left)}")  # or it would be kept
    assert left[0] == left[1] == left[2]
    assert len(left[0]["merge.zarr"]) == 10 + 3  # a file a run
    assert not list(level.glob(".work*"))


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """One certificate for all, as dask's settings name it."""
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
            connected(cluster.scheduler_address, tmp_path) as there,
        ):  # fmt: skip
            assert cluster.scheduler_address.startswith("tls://")
            assert there.hand_out(lambda first, last: first + last)(2, 3).result() == 5
            address = cluster.scheduler_address
    assert "not encrypted" not in caplog.text
    with pytest.raises(ClusterError, match=r"no ca-file and no client.cert.*docs/parallel"):
        connected(address, tmp_path).__enter__()


def test_plain_tcp_to_another_machine_is_warned_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(cluster_module, "_PATIENCE_SECONDS", 0.1)
    for host, is_warned in (("192.0.2.1", True), ("127.0.0.1", False), ("localhost", False)):
        caplog.clear()
        with pytest.raises(ClusterError, match="no scheduler answers"):
            connected(f"tcp://{host}:9", tmp_path).__enter__()
        assert ("dask unpickles what it gets" in caplog.text) == is_warned, host


def test_workers_can_pass_the_work_on(captured: Acquisition, monkeypatch: Any) -> None:
    runs = []
    call = merge._MergeRun.__call__

    def passed_on(self: Any, first: int, last: int) -> Any:
        result = call(pickle.loads(pickle.dumps(self)), first, last)
        runs.append(first)
        call(self, first, last)  # opens its stores
        return result

    monkeypatch.setattr(merge._MergeRun, "__call__", passed_on)
    captured.merge(0)
    assert runs == list(range(0, 20, 2))


def test_few_pieces_are_handed_out_at_a_time(address: str, tmp_path: Path) -> None:
    with Resources(where=address).workers(1, tmp_path) as workers:
        assert workers.in_flight == 4
        results = workers.results(lambda first, last: (os.getpid(), first, last), PIECES)
        found = list(results)
    assert [result[1:] for result in found] == PIECES
    assert os.getpid() not in {result[0] for result in found}
    small = Resources(memory_gib=1e-6, where=address)
    with small.workers(small.data_bytes, tmp_path) as workers:
        assert workers.in_flight == 1
        assert len(list(workers.results(lambda first, last: first, PIECES))) == 30


PIECES = [(index, index + 1) for index in range(30)]


def test_errors_come_back_from_the_workers(
    captured: Acquisition, address: str, tmp_path: Path
) -> None:
    captured.resources = Resources(where=address)
    chunk = damage(captured.folder.store(0, "capture"))
    manifest = captured.folder.manifest(0, "capture")
    with pytest.raises(IntegrityError, match=f"{chunk}.*remove {manifest} and run again"):
        captured.merge(0)
    manifest.unlink()
    captured.capture(0)
    captured.merge(0)

    def fails(first: int, _last: int) -> None:
        if first == 5:
            raise CaptureError("pattern 5 is no picture")

    with (
        pytest.raises(CaptureError, match="pattern 5 is no picture"),
        Resources(where=address).workers(1, tmp_path) as workers,
    ):
        list(workers.results(fails, PIECES))


def test_a_cluster_that_does_not_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "_PATIENCE_SECONDS", 1)
    with (
        pytest.raises(ClusterError, match=r"no scheduler answers there.*dask scheduler"),
        Resources(where="tcp://127.0.0.1:9").workers(1, tmp_path),
    ):
        pass


def test_a_cluster_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster_module, "_PATIENCE_SECONDS", 5)
    with (
        local_cluster(0) as empty,
        pytest.raises(ClusterError, match="has no workers, and none came within 5 s"),
        connected(empty.scheduler_address, tmp_path),
    ):
        pass


def test_workers_that_are_just_being_started_are_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster_module, "_PATIENCE_SECONDS", PATIENCE_SECONDS)
    with local_cluster(0) as empty:
        starting = threading.Timer(0.5, empty.scale, (1,))
        starting.start()
        with connected(empty.scheduler_address, tmp_path) as cluster:
            assert cluster.threads == 1
        starting.join()


def test_work_that_kills_its_worker(address: str, tmp_path: Path) -> None:
    with (
        pytest.raises(ClusterError, match=r"the work was lost.*too little memory"),
        Resources(where=address).workers(1, tmp_path) as workers,
    ):
        list(workers.results(lambda _first, _last: os._exit(1), PIECES))


@pytest.mark.parametrize(
    "wrong", ["localhost", "thread", "tcp://host", "http://host:8786", "tcp://a b:1"]
)
def test_an_address_that_is_none(wrong: str) -> None:
    with pytest.raises(ConfigError, match=r"resources\.workers"):
        settings_of_a_plane(resources={"workers": wrong})


@pytest.mark.slow
def test_a_run_with_a_cluster(copy: Workflow, undisturbed: Workflow, address: str) -> None:
    undo(copy, 3, "merge")
    copy.configure(resources={"workers": address})
    copy.run(TINY)
    assert copy.contents("tiny/symmetric") == undisturbed.contents("tiny/symmetric")
