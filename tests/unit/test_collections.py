"""Collections of transports, and packed folders that store each content once."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.results.acquired_collections import acquire_item
from tests.rigs.known_matrix import contents
from tests.services.web_servers import serving
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app
from rfpipe.config import Config, load_config
from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.report.catalogue import write_catalogue

ROWS = "name,kind,surfaces,shape,channels\na,plane,texture,6 x 8,1\nb,wedge,white white,6 x 8,1\n"
SETTINGS = """
collection: scenes.csv
methods: {hadamard: {}, brute_force: {}}
capture: {all_off_brackets: 3, all_on_brackets: 4}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, Path]:
    """Two scenes by two methods."""
    folder = tmp_path_factory.mktemp("collection")
    (folder / "scenes.csv").write_text(ROWS)
    (folder / "run.yaml").write_text(SETTINGS)
    settings = load_config(folder / "run.yaml")
    for scene, method in settings.acquisitions:
        acquire_item(settings, scene, method, folder / "results")
    return settings, folder / "results"


def test_a_collection_is_one_reflectance_field(run: tuple[Config, Path]) -> None:
    _, results = run
    field = rfpipe.open_collection(results, method="hadamard")
    assert list(field) == ["a", "b"]
    assert field.shape == (2, 6, 8, 6, 8)
    pattern = np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8)
    for name, picture in field.relight(pattern):
        transport = rfpipe.open_transport(results / name / "hadamard/transport.zarr")
        np.testing.assert_array_equal(picture, transport.relight(pattern))
    with pytest.raises(StoreError, match="by brute_force, hadamard; say which"):
        rfpipe.open_collection(results)
    with pytest.raises(StoreError, match="without folders of scenes; give the run's results"):
        rfpipe.open_collection(results / "a")
    with pytest.raises(StoreError, match="no transports by dual"):
        rfpipe.open_collection(results, method="dual")


def test_a_run_is_not_packed_into_itself(run: tuple[Config, Path]) -> None:
    output = run[1] / "packed"
    raised = CliRunner().invoke(app, ["collection", "pack", str(run[1]), "-o", str(output)])
    assert isinstance(raised.exception, InputError)
    assert "would be packed" in str(raised.exception)
    assert not output.exists()


def test_a_packed_run_is_readable_also_in_a_zip_and_is_restored(
    run: tuple[Config, Path], tmp_path: Path
) -> None:
    _, results = run
    packed = tmp_path / "packed"
    invoke = CliRunner().invoke
    output = invoke(app, ["collection", "pack", str(results), "-o", str(packed)]).output
    assert "are shared" in output
    plain = {name: of for name, of in contents(results).items() if ".lock" not in name}
    stored = sum(path.stat().st_size for path in packed.rglob("objects/*/*"))
    assert stored == sum(len(content) for content in set(plain.values()))
    archive = tmp_path / "packed.zip"
    with zipfile.ZipFile(archive, "w") as file:
        for path in packed.rglob("*"):
            file.write(path, path.relative_to(packed))
    pattern = np.eye(6, 8, dtype=np.float32)
    expected = dict(rfpipe.open_collection(results, "hadamard").relight(pattern))
    for where in (packed, archive):
        for name, picture in rfpipe.open_collection(where, "hadamard").relight(pattern):
            np.testing.assert_array_equal(picture, expected[name])
    transport = rfpipe.open_transport(packed / "a/hadamard/transport.zarr")
    np.testing.assert_array_equal(transport.relight(pattern), expected["a"])
    assert invoke(app, ["verify", str(packed)]).exit_code == 0
    unpacked = tmp_path / "results"
    assert invoke(app, ["collection", "unpack", str(packed), "-o", str(unpacked)]).exit_code == 0
    assert contents(unpacked) == plain
    largest = max(packed.glob("objects/*/*"), key=lambda path: path.stat().st_size)
    largest.write_bytes(largest.read_bytes()[:-1] + b"?")
    assert invoke(app, ["verify", str(packed)]).exit_code == 1
    result = invoke(app, ["collection", "unpack", str(packed), "-o", str(tmp_path / "again")])
    assert isinstance(result.exception, IntegrityError)
    assert str(largest) in str(result.exception)
    # packing again repairs it; a different file in its place is an error
    assert invoke(app, ["collection", "pack", str(results), "-o", str(packed)]).exit_code == 0
    assert invoke(app, ["verify", str(packed)]).exit_code == 0
    changed = unpacked / "a/hadamard/transport.json"
    changed.write_bytes(changed.read_bytes()[:-2] + b"?\n")
    result = invoke(app, ["collection", "unpack", str(packed), "-o", str(unpacked)])
    assert f"{changed}: exists with another content" in str(result.exception)


@pytest.fixture(scope="module")
def packed(run: tuple[Config, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packed") / "packed"
    done = CliRunner().invoke(
        app, ["collection", "pack", str(run[1]), "--transports", "-o", str(folder)]
    )
    assert done.exit_code == 0, done.output
    return folder


def test_a_packed_run_is_read_from_a_web_server(
    run: tuple[Config, Path], packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, output = run[1], tmp_path / "out"
    with serving(packed.parent) as server:
        address = f"{server.address}/packed"
        inside = "a/hadamard/transport.zarr"
        light = np.random.default_rng(1).random((6, 8))
        expected = rfpipe.open_transport(results / inside).relight(light)
        for name in (f"{address}/{inside}", f"{address}/a/hadamard"):
            assert np.array_equal(rfpipe.open_transport(name).relight(light), expected)
        field = rfpipe.open_collection(address, "hadamard")
        assert [*field] == ["a", "b"]
        assert np.array_equal(field["a"].relight(light), expected)
        with pytest.raises(StoreError, match="has 4 transports"):
            rfpipe.open_transport(address)
        with pytest.raises(StoreError, match="nowhere"):
            rfpipe.open_transport(f"{address}/nowhere/transport.zarr")
        # without a place, the command gets the address from the user
        monkeypatch.chdir(output.parent)
        for command in (["verify", address], ["collection", "unpack", address, "-o", str(output)]):
            done = CliRunner().invoke(app, command)
            assert done.exit_code == 0, done.output
        unpacked = sorted(it.relative_to(output) for it in output.rglob("*") if it.is_file())
        assert all((output / it).read_bytes() == (results / it).read_bytes() for it in unpacked)
        assert Path(inside) / "zarr.json" in unpacked


def test_a_collection_is_published_with_its_catalogue(
    run: tuple[Config, Path], packed: Path, tmp_path: Path
) -> None:
    settings, results = run
    write_catalogue(settings, results)
    cited = ["--license", "CC-BY-4.0", "--creator", "Doe, Jane", "-o", str(tmp_path / "crate")]
    invoke = CliRunner().invoke
    done = invoke(app, ["publish", str(results.parent), *cited])
    assert done.exit_code == 0, done.output
    assert "give --config" in done.output
    given = ["--config", str(results.parent / "run.yaml"), "--overwrite"]
    done = invoke(app, ["publish", str(results.parent), *cited, *given])
    assert done.exit_code == 0, done.output
    assert "give --config" not in done.output
    page = tmp_path / "crate/results/catalogue/index.html"
    assert "hadamard" in page.read_text()
    assert ".log" not in page.read_text()
    assert (page.parent / "a_hadamard.png").is_file()
    assert not (page.parent / "items.json").exists()
    assert "scenes:" in (tmp_path / "crate/settings.yaml").read_text()
    assert [*rfpipe.open_collection(tmp_path / "crate", "hadamard")] == ["a", "b"]
    with pytest.raises(InputError, match=r"is a packed run; .*rfpipe collection unpack"):
        invoke(app, ["publish", str(packed), *cited], catch_exceptions=False)
