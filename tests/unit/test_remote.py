"""Transports are opened from a folder, a zip file or an address, and relight bit for bit alike."""

import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from tests.buckets import BUCKET, put, s3_server, use
from tests.serving import serving
from typer.testing import CliRunner

import rfpipe
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.cli import app
from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.publish.contents import files_of_store
from rfpipe.transport import save_transport
from rfpipe.transport.hierarchical.leaves import LeafSet
from rfpipe.transport.hierarchical.transport import HierarchicalTransport

SHAPE = (24, 28)
DESK = "results/desk/symmetric/transport.zarr"
SHELF = "results/shelf/symmetric/transport.zarr"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two transports of several levels, and a zip file of the first, published."""
    folder = tmp_path_factory.mktemp("run")
    draw = np.random.default_rng(8)
    tree = BlockTree(RayDomain(SHAPE))
    sets = []
    for level in (1, 2):
        n = tree.n_blocks(level)
        a, b = np.triu_indices(n, 1)
        sizes = np.diff(tree.starts[level])
        values = draw.random((3, int((sizes[a] + sizes[b]).sum())), np.float32)
        sets.append(LeafSet(level, a.astype(np.int32), b.astype(np.int32), values))
    rows = [{"level": level, "patterns": 1} for level in range(3)]
    transport = HierarchicalTransport.from_leaf_sets(tree, 3, rows, sets)
    for name in (DESK, SHELF):
        (folder / name).parent.mkdir(parents=True)
        save_transport(transport, folder / name, "uint8")
    with zipfile.ZipFile(folder / "crate.zip", "w") as archive:
        for name, file in files_of_store(folder / DESK, DESK):
            archive.write(file, name)
        archive.writestr("README.md", "of a publication")
    with zipfile.ZipFile(folder / "both.zip", "w") as archive:
        for store in (DESK, SHELF):
            for name, file in files_of_store(folder / store, store):
                archive.write(file, name)
    with zipfile.ZipFile(folder / "store.zip", "w") as archive:
        for name, file in files_of_store(folder / DESK, ""):
            archive.write(file, name.lstrip("/"))
    return folder


@pytest.fixture(scope="module")
def light() -> np.ndarray:
    return np.random.default_rng(3).random(SHAPE, np.float32)


@pytest.fixture(scope="module")
def relit(run: Path, light: np.ndarray) -> np.ndarray:
    return rfpipe.open_transport(run / DESK).relight(light)


@pytest.mark.parametrize("name", ["crate.zip", f"crate.zip/{DESK}", "store.zip", "results/desk"])
def test_a_zip_file_or_folder_that_holds_a_transport_opens(
    name: str, run: Path, light: np.ndarray, relit: np.ndarray
) -> None:
    transport = rfpipe.open_transport(run / name)
    assert np.array_equal(transport.relight(light), relit)
    assert 1000 < transport.nbytes <= rfpipe.open_transport(run / DESK).nbytes


def test_of_several_transports_one_has_to_be_named(run: Path) -> None:
    for place in (run, run / "both.zip"):
        with pytest.raises(StoreError, match="has 2 transports") as caught:
            rfpipe.open_transport(place)
        assert f"{place}/{SHELF}" in str(caught.value)
        named = str(caught.value).splitlines()[1].strip()
        assert rfpipe.open_transport(named).camera_shape == SHAPE


def test_a_zip_file_behind_an_address_takes_few_requests(
    run: Path, light: np.ndarray, relit: np.ndarray
) -> None:
    with serving(run) as server:
        transport = rfpipe.open_transport(f"{server.address}/crate.zip")
        assert len(server.requests) <= 2
        assert np.array_equal(transport.relight(light), relit)
        assert len(server.requests) <= 4
        tail = 256 * 2**10
        assert server.nbytes <= (run / "crate.zip").stat().st_size + tail
        before = len(server.requests)
        transport.relight(light)
        assert len(server.requests) == before


def test_what_is_not_used_is_not_fetched(run: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "large.zip", "w") as archive:
        for name, file in files_of_store(run / DESK, DESK):
            archive.write(file, name)
        archive.writestr("frames.bin", bytes(8_000_000))
        archive.writestr("README.md", "last")
    stored = sum(file.stat().st_size for file in (run / DESK).rglob("*") if file.is_file())
    with serving(tmp_path) as server:
        rfpipe.open_transport(f"{server.address}/large.zip").relight(np.ones(SHAPE))
        assert server.nbytes < stored + 256 * 2**10 + 20_000  # the zip's end, headers


def test_commands_take_addresses_and_zip_files(run: Path) -> None:
    with serving(run) as server:
        for place in (run / "crate.zip", f"{server.address}/crate.zip"):
            shown = CliRunner().invoke(app, ["info", str(place)], catch_exceptions=False)
            assert "24 x 28 = 672 rays" in shown.output


def test_a_store_behind_an_address_opens(run: Path, light: np.ndarray, relit: np.ndarray) -> None:
    with serving(run) as server:
        transport = rfpipe.open_transport(f"{server.address}/{DESK}")
        assert len(server.requests) == 1
        assert np.array_equal(transport.relight(light), relit)
        # a Path made of an address has lost a slash
        again = rfpipe.open_transport(Path(f"{server.address}/{DESK}"))
        assert np.array_equal(again.relight(light), relit)


def test_a_published_folder_behind_an_address_tells_its_transports(
    run: Path, tmp_path: Path, light: np.ndarray, relit: np.ndarray
) -> None:
    for name, file in files_of_store(run / DESK, f"crate/{DESK}"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(file.read_bytes())
    (tmp_path / "crate/manifest-sha256.txt").write_text(f"{64 * '0'}  {DESK}/zarr.json\n")
    with serving(tmp_path) as server:
        found = rfpipe.open_transport(f"{server.address}/crate")
        assert np.array_equal(found.relight(light), relit)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nothing.zip", "no such file"),
        ("nothing/transport.zarr", "no store of arrays"),
        ("results", "doesn't list its files"),
        ("crate.zip?download=1", "without '\\?'"),
    ],
)
def test_what_an_address_lacks_is_said(name: str, says: str, run: Path) -> None:
    with serving(run) as server, pytest.raises((StoreError, InputError), match=says) as caught:
        rfpipe.open_transport(f"{server.address}/{name}")
    assert "Debug source" not in str(caught.value)


def test_a_server_without_ranges_is_said(run: Path) -> None:
    with serving(run, ranges=False) as server, pytest.raises(StoreError, match="range requests"):
        rfpipe.open_transport(f"{server.address}/crate.zip")


def test_another_kind_of_address_is_refused() -> None:
    with pytest.raises(InputError, match="expected http://, https:// or s3://"):
        rfpipe.open_transport("ftp://example.org/crate.zip")


def test_damage_is_found_wherever_it_lies(run: Path, tmp_path: Path) -> None:
    content = bytearray((run / "crate.zip").read_bytes())
    with zipfile.ZipFile(run / "crate.zip") as archive:
        inside = next(info for info in archive.infolist() if info.filename.endswith("values/c.0.0")
                      or info.filename.endswith("codes/c.0.0"))  # fmt: skip
    content[inside.header_offset + 200] ^= 1
    (tmp_path / "crate.zip").write_bytes(content)
    with serving(tmp_path) as server:
        for place in (str(tmp_path / "crate.zip"), f"{server.address}/crate.zip"):
            with pytest.raises(IntegrityError, match="anew"):
                rfpipe.open_transport(place).relight(np.ones(SHAPE))
    (tmp_path / "short.zip").write_bytes(content[:-100])
    with pytest.raises(StoreError, match="can't be read as a zip file"):
        rfpipe.open_transport(tmp_path / "short.zip")


def test_the_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(StoreError, match=r"rfpipe\[publish\]"):
        rfpipe.open_transport("https://example.org/crate.zip")


@pytest.fixture(scope="module")
def bucket(run: Path) -> Iterator[str]:
    """A bucket of a local S3 server, with the run in it; its endpoint."""
    with s3_server() as endpoint:
        files = [*files_of_store(run / DESK, DESK), *files_of_store(run / SHELF, SHELF)]
        for name, file in [*files, ("crate.zip", run / "crate.zip")]:
            put(f"{endpoint}/{BUCKET}/{name}", file.read_bytes())
        yield endpoint


@pytest.mark.parametrize("signed", [False, True])
def test_s3_is_read_signed_or_not(
    signed: bool,
    bucket: str,
    run: Path,
    light: np.ndarray,
    relit: np.ndarray,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    use(monkeypatch, bucket, signed=signed)
    for key in ("crate.zip", DESK, "results/desk"):
        transport = rfpipe.open_transport(f"s3://lab/{key}")
        assert np.array_equal(transport.relight(light), relit), key
    assert transport.nbytes == rfpipe.open_transport(run / DESK).nbytes
    with pytest.raises(StoreError, match="has 2 transports"):
        rfpipe.open_transport("s3://lab/results")
    with pytest.raises(StoreError, match="no such file"):
        rfpipe.open_transport("s3://lab/nothing.zip")
