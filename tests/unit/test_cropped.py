"""Crops of a transport relight as the full transport, and load only their own data."""

import zipfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from tests.services.buckets import BUCKET, proxy, put, s3_server, use

import rfpipe
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError, IntegrityError
from rfpipe.publishing.run import files_below
from rfpipe.store.packed import pack_files
from rfpipe.transport import save_transport
from rfpipe.transport.hierarchical.leaves import LeafSet
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.sum import SumTransport

SHAPE = (9, 24, 28)
STORE = "results/field/symmetric/transport.zarr"


@cache
def light_field() -> HierarchicalTransport:
    """A transport of nine views with leaves of each level between all pairs of views."""
    draw = np.random.default_rng(4)
    tree = BlockTree(RayDomain(SHAPE))
    sets = []
    for level in (1, 3, tree.n_levels - 1):
        n_blocks = tree.n_blocks(level)
        if n_blocks < 150:
            pairs = np.transpose(np.triu_indices(n_blocks)).astype(np.int32)
        else:
            pairs = draw.integers(n_blocks, size=(12_000, 2), dtype=np.int32)
        a, b = np.unique(np.sort(pairs, axis=1), axis=0).T
        sizes = np.diff(tree.starts[level])
        n_values = int((sizes[a] + np.where(a == b, 0, sizes[b])).sum())
        if level == tree.n_levels - 1:
            n_values = len(a)
        sets.append(LeafSet(level, a, b, draw.random((3, n_values), np.float32)))
    return HierarchicalTransport.from_leaf_sets(tree, 3, [{"level": 0, "patterns": 1}], sets)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    (folder / STORE).parent.mkdir(parents=True)
    save_transport(light_field(), folder / STORE, "uint8")
    with zipfile.ZipFile(folder / "crate.zip", "w") as archive:
        for name, file in files_below(folder / STORE, STORE):
            archive.write(file, name)
    return folder


@pytest.mark.parametrize("kind", ["stored", "memory", "sum", "dual"])
def test_a_crop_relights_as_the_full_transport(kind: str, run: Path) -> None:
    light = np.random.default_rng(3).random(SHAPE, np.float32)
    opened = rfpipe.open_transport(run / STORE)
    complete = {
        "memory": light_field(),
        "sum": SumTransport([light_field(), opened], []),
        "dual": opened.T,
    }.get(kind, opened)
    expected = complete.relight(light)
    fresh = rfpipe.open_transport(run / STORE) if kind == "stored" else complete
    scale = expected.max() * 1e-5
    for part in (np.s_[4], np.s_[8, 3:11, ::2], np.s_[2:4], np.s_[:, :, 5:6]):
        raised = rfpipe.crop(fresh, camera=part).relight(light)
        assert raised.shape == expected[part].shape
        np.testing.assert_allclose(raised, expected[part], atol=scale)
        lit = np.zeros_like(light)
        lit[part] = light[part]
        raised = rfpipe.crop(fresh, np.s_[1:, 2:], part).relight(light[part])
        np.testing.assert_allclose(raised, complete.relight(lit)[1:, 2:], atol=scale)
    symmetric_part = rfpipe.crop(fresh, 3, np.s_[6, :8])
    assert np.allclose(
        symmetric_part.toarray(), symmetric_part.T.toarray().swapaxes(1, 2), atol=scale
    )


def test_missing_rays_are_refused(run: Path) -> None:
    transport = rfpipe.open_transport(run / STORE)
    for wrong in (9, np.s_[3, 4], np.s_[2:2], "view"):
        with pytest.raises(InputError, match=r"camera = .* of rays \(9, 24, 28\): expected"):
            rfpipe.crop(transport, camera=wrong)


def test_a_view_is_fetched_from_a_bucket_by_ranges(
    run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, validators: str
) -> None:
    """One of nine views needs a fifth of the pairs of views, and a part of it fewer blocks."""
    pack_files(run, [file for _, file in files_below(run / STORE, STORE)], tmp_path / "packed")
    light = np.random.default_rng(3).random(SHAPE, np.float32)
    expected = rfpipe.open_transport(run / STORE).relight(light)
    stored = sum(file.stat().st_size for _, file in files_below(run / STORE, STORE))
    with s3_server(validators) as server, proxy(server) as bucket:
        for name, file in [*files_below(run / STORE, STORE), ("crate.zip", run / "crate.zip")]:
            put(f"{server}/{BUCKET}/{name}", file.read_bytes())
        for file in filter(Path.is_file, (tmp_path / "packed").rglob("*")):
            name = file.relative_to(tmp_path).as_posix()
            put(f"{server}/{BUCKET}/{name}", file.read_bytes())
        use(monkeypatch, bucket.endpoint)

        def fetched(place: str, part: object) -> int:
            transport = rfpipe.open_transport(f"s3://{BUCKET}/{place}")
            opened = len(bucket.requests)
            raised = rfpipe.crop(transport, camera=part).relight(light)
            np.testing.assert_allclose(raised, expected[part], atol=expected.max() * 1e-5)
            return sum(received for *_, received in bucket.requests[opened:])

        for place in (STORE, "crate.zip", f"packed/{STORE}"):
            every = fetched(place, np.s_[:])
            assert 0.9 * stored < every, place
            assert fetched(place, np.s_[4]) < 0.4 * stored, place
            assert fetched(place, np.s_[4, :4, :5]) < 0.4 * stored, place


def test_damage_in_a_part_is_detected(run: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(run / "crate.zip") as archive:
        archive.extractall(tmp_path)
    chunk = next((tmp_path / STORE).glob("level_03_*_codes/c.0.0"))
    content = bytearray(chunk.read_bytes())
    content[200] ^= 1
    chunk.write_bytes(content)
    assert rfpipe.crop(rfpipe.open_transport(tmp_path), 8).relight(np.ones(SHAPE)).any()
    with pytest.raises(IntegrityError, match=r"array 'level_03_.*_codes'"):
        rfpipe.crop(rfpipe.open_transport(tmp_path), 0).relight(np.ones(SHAPE))
