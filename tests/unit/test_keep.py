"""Upload of a run's results to a bucket: complete after any failure, and readable remotely."""

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.results.finished_run import SHAPE, N, write_run, write_transport
from tests.services.buckets import BUCKET, Faults, proxy, s3_server, use
from tests.services.waiting import wait_until
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app
from rfpipe.config import parse_config
from rfpipe.errors import ConfigError, StoreError
from rfpipe.publishing.keep import UploadSummary, keep
from rfpipe.publishing.run import find_run
from rfpipe.store import addresses, open_arrays, write_arrays
from rfpipe.store.addresses import Bucket
from rfpipe.store.location import locate
from rfpipe.store.places import content_of

SCENES = ("desk", "shelf", "wall")
N_OBJECTS = 11
LIST = "manifest-sha256.txt"
_folders = itertools.count()


@pytest.fixture(scope="module")
def server(validators: str) -> Iterator[str]:
    with s3_server(validators) as endpoint:
        yield endpoint


@pytest.fixture
def faults(server: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[Faults]:
    """A proxy in front of the server; the environment has its address."""
    with proxy(server) as summary:
        use(monkeypatch, summary.endpoint)
        yield summary


@pytest.fixture
def address() -> str:
    """Address of a new folder in the bucket."""
    return f"s3://{BUCKET}/run{next(_folders)}"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run", *SCENES)


def upload(run: Path, address: str) -> UploadSummary:
    summary = keep(find_run(run), address)
    assert not list(run.rglob(".keep*"))
    return summary


def verified(address: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["verify", address], catch_exceptions=False)
    return result.exit_code, result.output


def listed(address: str) -> dict[str, str]:
    content = content_of(Bucket(address) / LIST) or b""
    return {line[66:]: line[:64] for line in content.decode().splitlines()}


def test_results_are_uploaded_once_and_readable_in_the_bucket(
    run: Path, address: str, faults: Faults, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary = upload(run, address)
    names = {f"results/{scene}/dual/{part}.zip" for scene in SCENES
             for part in ("transport", "relight")}  # fmt: skip
    report = ("index.html", "view/desk.html", "tables/errors.csv", "results.json")
    names |= {"provenance.zip", *(f"results/report/{name}" for name in report)}
    assert set(listed(address)) == names
    assert (summary.objects, summary.sent) == (len(names), len(names))
    assert faults.written()[-1].endswith(LIST)
    assert not any("capture" in path for path in faults.written())
    assert verified(address)[0] == 0

    before = len(faults.requests)
    second = upload(run, address)
    assert (second.objects, second.sent) == (len(names), 0)
    assert len(faults.requests) - before == 2  # a listing of the bucket, and its list of files

    write_transport(run, "shelf", np.ones((3, N, N)))
    (run / "results/report/index.html").write_text("<h1>Another</h1>")
    third = upload(run, address)
    assert third.sent == 2
    shelf = rfpipe.open_transport(f"{address}/results/shelf/dual/transport.zip")
    assert np.allclose(shelf.relight(np.ones(SHAPE)), N)
    with pytest.raises(StoreError, match="has 3 transports"):
        rfpipe.open_transport(address)
    light = np.random.default_rng(3).random(SHAPE)
    local = rfpipe.open_transport(run / "results/desk").relight(light)
    for signed in (True, False):  # a public bucket needs no credentials
        use(monkeypatch, faults.endpoint, signed=signed)
        remote = rfpipe.open_transport(f"{address}/results/desk")
        assert np.array_equal(remote.relight(light), local)
    with pytest.raises(StoreError, match="no such file"):
        rfpipe.open_transport(f"{address}/nothing.zip")


def test_uploads_are_retried_after_network_and_server_errors(
    run: Path, address: str, faults: Faults
) -> None:
    faults.fail, faults.cut = 2, 2
    assert upload(run, address).sent == N_OBJECTS
    assert (faults.fail, faults.cut) == (0, 0)
    assert verified(address)[0] == 0


def test_a_broken_server_is_reported_and_the_next_upload_continues(
    run: Path, address: str, faults: Faults, monkeypatch: pytest.MonkeyPatch
) -> None:
    send, sent = Bucket.put, []

    def breaking(bucket: Bucket, name: str, content: Path | bytes) -> None:
        if len(sent) == 2:
            faults.fail = 1000
        sent.append(name)
        send(bucket, name, content)

    with monkeypatch.context() as patched:
        patched.setattr(addresses, "_RETRIES", {"max_retries": 1})
        patched.setattr(Bucket, "put", breaking)
        with pytest.raises(StoreError, match="an upload continues where it stopped") as caught:
            upload(run, address)
    assert "\n" not in str(caught.value)
    faults.fail = 0
    assert upload(run, address).sent == N_OBJECTS
    assert verified(address)[0] == 0


def test_missing_buckets_permissions_and_credentials_are_explained(
    run: Path, address: str, faults: Faults, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(StoreError, match="no such bucket; create it"):
        upload(run, "s3://nobody/run")
    faults.deny = True
    with pytest.raises(StoreError, match=r"Not now; check .*AWS_SECRET_ACCESS_KEY"):
        upload(run, address)
    assert listed(address) == {}
    for wrong in ("lab/run", "s3://", "s3://key:secret@lab/run", "s3://Lab/run"):
        with pytest.raises(ConfigError, match=r"keep_at.*bucket") as refused:
            parse_config({"storage": {"keep_at": wrong}}, "test")
    assert "secret" not in str(refused.value)


def test_a_killed_upload_leaves_no_partial_object_and_continues(
    run: Path, address: str, faults: Faults
) -> None:
    command = [sys.executable, "-m", "rfpipe.cli", "keep", str(run), address]
    for limit in (1, 4):
        faults.limit = limit
        uploader = subprocess.Popen(command, env=os.environ, stderr=subprocess.DEVNULL)
        wait_until(lambda: len(faults.written()) >= faults.limit and faults.under_way, "writes")
        uploader.send_signal(signal.SIGKILL)
        assert uploader.wait() == -signal.SIGKILL
        faults.limit = None
        wait_until(lambda: not faults.under_way, "the end of what was sent")
        bucket = Bucket(address)
        assert len(bucket.sizes()) < N_OBJECTS
        for name in bucket.sizes():
            if name.endswith("transport.zip"):
                transport = rfpipe.open_transport(f"{address}/{name}")
                assert transport.relight(np.ones(SHAPE)).shape == (*SHAPE, 3)
        for name in listed(address):
            assert name in bucket.sizes()
    assert upload(run, address).objects == N_OBJECTS
    assert verified(address)[0] == 0
    assert len(listed(address)) == N_OBJECTS


def test_damaged_objects_are_detected_and_sent_again(
    run: Path, address: str, faults: Faults
) -> None:
    upload(run, address)
    bucket = Bucket(address)
    name = "results/desk/dual/transport.zip"
    bucket.put(name, b"half of it")
    bucket.put("results/strange.txt", b"of somebody else")
    status, output = verified(address)
    assert status == 1
    assert f"{address}/{name}: is altered" in output
    assert "strange.txt: isn't in the list" in output
    assert upload(run, address).sent == 1
    assert verified(address)[0] == 0
    for place in (f"{address}/{name}", f"{address}/results/desk"):
        status, output = verified(place)
        assert (status, "1 stores" in output) == (0, True), output


def test_a_sharded_store_is_read_and_verified_in_a_bucket(
    run: Path, address: str, faults: Faults
) -> None:
    store = run / "results/desk/dual/transport.zarr"
    large = np.random.default_rng(0).random((3, 400_000), np.float32)
    write_arrays(store, {"large": large}, {"kind": "test"})
    bucket = Bucket(address)
    for file in store.rglob("*"):
        if file.is_file():
            bucket.put(file.relative_to(store).as_posix(), file)
    bundle = open_arrays(locate(address))
    assert np.array_equal(bundle.read("large"), large)
    faults.requests.clear()
    assert verified(address)[0] == 0
    shard = content_of(bucket / "large/c.0.0")
    assert shard is not None
    bucket.put("large/c.0.0", shard[:-1])
    status, output = verified(address)
    assert (status, "'large' is missing, truncated or altered" in output) == (1, True), output
