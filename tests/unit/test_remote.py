"""Transports in folders, zip files and at addresses: opening, equal bytes, damage."""

import base64
import hashlib
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.property.test_hierarchical import random_transport
from tests.rigs import known_matrix
from tests.services.buckets import use
from tests.services.web_servers import serving

import rfpipe
from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.publishing.run import files_below
from rfpipe.publishing.writing import write_zip
from rfpipe.transport import save_transport

SHAPE = (24, 28)
DESK = "results/desk/symmetric/transport.zarr"
SHELF = "results/shelf/symmetric/transport.zarr"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two transports of several levels, and a zip file of the first, published."""
    folder = tmp_path_factory.mktemp("run")
    transport, _ = random_transport(SHAPE, 3, seed=8)
    for name in (DESK, SHELF):
        (folder / name).parent.mkdir(parents=True)
        save_transport(transport, folder / name, "uint8")
    write_zip(folder / "crate.zip", [*files_below(folder / DESK, DESK), ("README.md", b"of it")])
    files = (file for name in (DESK, SHELF) for file in files_below(folder / name, name))
    write_zip(folder / "both.zip", files)
    store = files_below(folder / DESK, "")
    write_zip(folder / "store.zip", ((name.lstrip("/"), file) for name, file in store))
    return folder


@pytest.fixture(scope="module")
def light() -> np.ndarray:
    return np.random.default_rng(3).random(SHAPE, np.float32)


@pytest.fixture(scope="module")
def relit(run: Path, light: np.ndarray) -> np.ndarray:
    return rfpipe.open_transport(run / DESK).relight(light)


@pytest.mark.parametrize("name", ["crate.zip", f"crate.zip/{DESK}", "store.zip", "results/desk"])
def test_a_zip_file_or_folder_with_one_transport_opens(
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


def test_a_store_behind_an_address_opens(run: Path, light: np.ndarray, relit: np.ndarray) -> None:
    with serving(run) as server:
        transport = rfpipe.open_transport(f"{server.address}/{DESK}")
        assert len(server.requests) == 2
        assert np.array_equal(transport.relight(light), relit)
        # a Path of an address has one slash less
        transport = rfpipe.open_transport(Path(f"{server.address}/{DESK}"))
        assert np.array_equal(transport.relight(light), relit)


def test_an_address_may_be_encoded_as_browsers_copy_it(run: Path, tmp_path: Path) -> None:
    inside = tmp_path / "a b/100% ü"
    inside.mkdir(parents=True)
    (inside / "crate.zip").write_bytes((run / "crate.zip").read_bytes())
    with serving(tmp_path) as server:
        for folder in ("a%20b/100%25%20%C3%BC", "a b/100%25 ü", "a b/100% ü"):
            rfpipe.open_transport(f"{server.address}/{folder}/crate.zip")


def test_the_password_of_an_address_reaches_its_server(run: Path) -> None:
    with serving(run) as server:
        rfpipe.open_transport(f"{server.address.replace('://', '://jane:a%40b@')}/crate.zip")
        rfpipe.open_transport(f"{server.address}/crate.zip")
        given = f"Basic {base64.b64encode(b'jane:a@b').decode()}"
        assert [*dict.fromkeys(server.authorizations)] == [given, None]


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("{server}/nothing.zip", "no such file"),
        ("{server}/results", "doesn't list its files"),
        ("{server}/crate.zip?download=1", "without '\\?'"),
        ("{no_ranges}/crate.zip", "range requests"),
        ("http://[::1", "Invalid IPv6"),
        ("s3://key:geheim@lab/run", "environment: AWS_ACCESS_KEY_ID"),
        ("s3://La b/run", "expected a bucket"),
        ("s3://lab/run.zip", "Missing SecretAccessKey; check .*AWS_"),
    ],
)
def test_invalid_addresses_are_explained(
    address: str, message: str, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, "http://127.0.0.1:9")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    with serving(run) as server, serving(run, ranges=False) as whole_files:
        named = address.format(server=server.address, no_ranges=whole_files.address)
        with pytest.raises((StoreError, InputError), match=message) as caught:
            rfpipe.open_transport(named)
    for hidden in ("geheim", "Debug source", "\n"):
        assert hidden not in str(caught.value)


def test_damage_is_found_at_any_address(run: Path, tmp_path: Path) -> None:
    content = bytearray((run / "crate.zip").read_bytes())
    with zipfile.ZipFile(run / "crate.zip") as archive:
        inside = next(info for info in archive.infolist() if "codes/c.0" in info.filename)
    content[inside.header_offset + 200] ^= 1
    (tmp_path / "crate.zip").write_bytes(content)
    with serving(tmp_path) as server:
        for place in (str(tmp_path / "crate.zip"), f"{server.address}/crate.zip"):
            with pytest.raises(IntegrityError, match="again"):
                rfpipe.open_transport(place).relight(np.ones(SHAPE))
    (tmp_path / "short.zip").write_bytes(content[:-100])
    with pytest.raises(StoreError, match="can't be read as a zip file"):
        rfpipe.open_transport(tmp_path / "short.zip")


def test_a_zip_made_again_by_another_program_is_read_and_checked(run: Path, tmp_path: Path) -> None:
    light = np.random.default_rng(4).random(SHAPE)
    archive_path = tmp_path / "again.zip"
    with zipfile.ZipFile(archive_path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, file in files_below(run / DESK, DESK):
            archive.write(file, name)
    relit = rfpipe.open_transport(run / "crate.zip").relight(light)
    assert np.array_equal(rfpipe.open_transport(archive_path).relight(light), relit)
    content = archive_path.read_bytes()
    with zipfile.ZipFile(archive_path) as archive:
        chunk = max(archive.infolist(), key=lambda info: info.compress_size)
        first = chunk.header_offset + 30 + len(chunk.filename)
    for start, fill in ((first, b"\xff" * 16), (chunk.header_offset, b"????")):
        damaged = bytearray(content)
        damaged[start : start + len(fill)] = fill
        archive_path.write_bytes(damaged)
        with pytest.raises(IntegrityError, match="again"):
            rfpipe.open_transport(archive_path).relight(light)
        assert "is missing, truncated or altered" in verified(archive_path, status=1)


def test_a_zip_of_transports_is_verified_where_it_lies(run: Path) -> None:
    assert "undamaged. 1 stores" in verified(run / "crate.zip")
    assert "undamaged. 2 stores" in verified(run / "both.zip")
    assert "undamaged. 1 stores" in verified(run / "both.zip" / DESK)
    with pytest.raises(InputError, match="holds nothing of a run"):
        verified(run / "nothing.zip")


def test_missing_files_of_a_folder_on_a_web_server_are_found(tmp_path: Path) -> None:
    files = {"a.txt": b"of a publication", "b.txt": b"of one", "c.txt": b"", "d.txt": b"of one"}
    listed = [f"{hashlib.sha256(of).hexdigest()}  {name}\n" for name, of in files.items()]
    (tmp_path / "manifest-sha256.txt").write_text("".join(listed))
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    with serving(tmp_path) as server:
        assert "undamaged. 0 stores, 0 manifests and 4 other files" in verified(server.address)
        (tmp_path / "b.txt").unlink()
        (tmp_path / "d.txt").write_bytes(b"of another")
        output = verified(server.address, status=1)
    assert f"{server.address}/b.txt: is missing" in output
    assert f"{server.address}/d.txt: is altered" in output


def verified(path: Path | str, status: int = 0) -> str:
    return known_matrix.run("verify", path, status=status)


def test_the_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(StoreError, match=r"pip install .*\[publish\]"):
        rfpipe.open_transport("https://example.org/crate.zip")
