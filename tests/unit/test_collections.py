"""Collections on files: shared references, one field of all transports, contents kept once."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from tests.collections_ import acquire_item
from typer.testing import CliRunner

import rfpipe
from rfpipe.cli import app
from rfpipe.config import Config, load_config
from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.store import FrameStore, read_manifest

ROWS = "name,kind,surfaces,shape,channels\na,plane,texture,6 x 8,1\nb,wedge,white white,6 x 8,1\n"
SETTINGS = """
collection: scenes.csv
methods: {hadamard: {}, brute_force: {}}
capture: {black_frames: 3, floodlit_frames: 4, share_references: all}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Config, Path]:
    """Two scenes by two methods, with shared references."""
    folder = tmp_path_factory.mktemp("collection")
    (folder / "scenes.csv").write_text(ROWS)
    (folder / "run.yaml").write_text(SETTINGS)
    settings = load_config(folder / "run.yaml")
    for scene, method in settings.acquisitions:
        acquire_item(settings, scene, method, folder / "results")
    return settings, folder / "results"


def store_of(results: Path, name: str) -> FrameStore:
    return FrameStore.open(results / name)


def test_references_are_taken_once_and_are_those_taken_alone(
    run: tuple[Config, Path], tmp_path: Path
) -> None:
    settings, results = run
    kept = sorted(path.name.partition("_")[0] for path in (results / "references").glob("*.zarr"))
    assert kept == ["black", "floodlit", "floodlit"]  # of the rig, and of each scene
    alone = settings.model_copy(
        update={"capture": settings.capture.model_copy(update={"share_references": "none"})}
    )
    name = "b/hadamard/L00/reference.zarr"
    acquire_item(alone, "b", "hadamard", tmp_path)
    assert not (tmp_path / "references").exists()
    assert store_of(results, name).digest() == store_of(tmp_path, name).digest()
    transports = [it / "b/hadamard/transport.json" for it in (results, tmp_path)]
    first, second = (read_manifest(path)["digest"] for path in transports)
    assert first == second


def test_shared_references_are_not_taken_again(
    run: tuple[Config, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, results = run
    shutil.copytree(results / "references", tmp_path / "references")
    shown: list[tuple[int, ...]] = []
    from rfpipe.rigs import SimulatedRig

    capture = SimulatedRig.capture

    def counted(self: SimulatedRig, patterns: np.ndarray, keys: list[tuple[int, ...]]) -> object:
        shown.extend(keys)
        return capture(self, patterns, keys)

    monkeypatch.setattr(SimulatedRig, "capture", counted)
    acquire_item(settings, "a", "brute_force", tmp_path)
    from rfpipe.rigs import BLACK_LEVEL_KEY, FLOODLIT_KEY

    assert len(shown) == 48
    assert not {BLACK_LEVEL_KEY, FLOODLIT_KEY} & {key[0] for key in shown}


def test_a_collection_is_one_field(run: tuple[Config, Path]) -> None:
    _, results = run
    field = rfpipe.open_collection(results, method="hadamard")
    assert list(field) == ["a", "b"]
    assert field.shape == (2, 6, 8, 6, 8)
    pattern = np.linspace(0, 1, 48, dtype=np.float32).reshape(6, 8)
    for name, picture in field.relight(pattern):
        alone = rfpipe.open_transport(results / name / "hadamard/transport.zarr")
        np.testing.assert_array_equal(picture, alone.relight(pattern))
    lamps = {"a": pattern, "b": np.ones((6, 8), np.float32)}
    both = field.light_from(lamps)
    apart = [field[name].T.relight(light) for name, light in lamps.items()]
    np.testing.assert_allclose(both, sum(apart), rtol=1e-6)
    with pytest.raises(StoreError, match="by brute_force, hadamard; say which"):
        rfpipe.open_collection(results)
    with pytest.raises(StoreError, match="no transports by dual"):
        rfpipe.open_collection(results, method="dual")
    with pytest.raises(InputError, match="'c' is no position"):
        field.light_from({"c": pattern})


def test_a_packed_run_reads_alike_survives_a_zip_and_comes_back(
    run: tuple[Config, Path], tmp_path: Path
) -> None:
    _, results = run
    packed = tmp_path / "packed"
    invoke = CliRunner().invoke
    said = invoke(app, ["collection", "pack", str(results), "-o", str(packed)]).output
    assert "are shared" in said
    plain = {
        path.relative_to(results): path.read_bytes()
        for path in results.rglob("*")
        if path.is_file() and ".lock" not in path.name
    }
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
    one = rfpipe.open_transport(packed / "a/hadamard/transport.zarr")
    np.testing.assert_array_equal(one.relight(pattern), expected["a"])
    assert invoke(app, ["verify", str(packed)]).exit_code == 0
    back = tmp_path / "results"
    assert invoke(app, ["collection", "unpack", str(packed), "-o", str(back)]).exit_code == 0
    assert plain == {
        path.relative_to(back): path.read_bytes() for path in back.rglob("*") if path.is_file()
    }
    largest = max(packed.glob("objects/*/*"), key=lambda path: path.stat().st_size)
    largest.write_bytes(largest.read_bytes()[:-1] + b"?")
    assert invoke(app, ["verify", str(packed)]).exit_code == 1
    result = invoke(app, ["collection", "unpack", str(packed), "-o", str(tmp_path / "again")])
    assert isinstance(result.exception, IntegrityError)
    assert str(largest) in str(result.exception)
