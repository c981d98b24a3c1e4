"""Stored transports: number formats, memory budget and threads."""

from pathlib import Path

import numba
import numpy as np
import pytest
from tests.property.test_hierarchical import random_transport
from tests.rigs.known_matrix import contents

import rfpipe
from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.store import write_arrays
from rfpipe.transport import Transport, open_transport, save_transport
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.hierarchical import leaves, truncation
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.sum import SumTransport

SHAPE = (24, 28)


@pytest.fixture(scope="module")
def transport() -> Transport:
    rig = SimulatedRig(reference_scene("IV", SHAPE, channels=3))
    return rfpipe.acquire(rig, tolerance=1e-4, progress=False).transport


@pytest.fixture(scope="module")
def dual() -> Transport:
    rig = SimulatedRig(reference_scene("IV", SHAPE, channels=3))
    return rfpipe.acquire(rig, "dual", tolerance=1e-3, progress=False).transport


PATTERNS = np.stack(list(relighting_patterns(SHAPE).values()))


def test_only_a_hierarchy_is_truncated_to_an_earlier_level(transport: Transport) -> None:
    rows, last = transport.level_rows, transport.last_level
    assert list(transport.known_levels) == [row["level"] for row in rows]
    matrix = {"matrix": np.ones((3, 6, 6), np.float32)}
    dense = DenseTransport((2, 3), (2, 3), 3, rows, matrix)
    for untruncated in (SumTransport([transport], rows), dense):
        assert untruncated.truncate(last) is untruncated
        with pytest.raises(InputError, match=f"known after level {last} only"):
            untruncated.truncate(last - 1)
    for level in (-1, last + 1):
        with pytest.raises(InputError, match=f"known after level 0 to {last}"):
            transport.truncate(level)


def test_levels_in_messages_are_levels_with_patterns() -> None:
    with_patterns = [{"level": level, "patterns": 9 - level} for level in range(3)]
    rows = [*with_patterns, *({"level": level, "patterns": 0} for level in range(3, 28))]
    matrix = {"matrix": np.ones((3, 6, 6), np.float32)}
    dense = DenseTransport((2, 3), (2, 3), 3, rows, matrix)
    for transport in (dense, SumTransport([dense, dense], rows)):
        assert list(transport.known_levels) == [transport.last_level] == [2]
        assert transport.truncate(2) is transport
        with pytest.raises(InputError, match=r"level 99 .*known after level 2 only"):
            transport.truncate(99)


def test_fewer_bits_give_smaller_stores(
    transport: Transport, dual: Transport, tmp_path: Path
) -> None:
    for acquired in (transport, dual):
        sizes = []
        for number_format in ("float32", "uint16", "uint8"):
            save_transport(acquired, tmp_path / number_format, number_format)
            sizes.append(open_transport(tmp_path / number_format).nbytes)
        assert sizes == sorted(sizes, reverse=True)
        assert sizes[2] < 0.65 * sizes[0]


def test_an_unknown_number_format_is_rejected(transport: Transport, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="number format 'uint4'; expected one of float32, uint16"):
        save_transport(transport, tmp_path / "transport.zarr", "uint4")  # type: ignore[arg-type]
    arrays, attributes = transport.pack()
    write_arrays(tmp_path / "later", arrays, {**attributes, "number_format": "uint4"})
    with pytest.raises(StoreError, match="'uint4' is unknown to this version of rfpipe; op"):
        open_transport(tmp_path / "later")


@pytest.mark.parametrize("number_format", ["float32", "uint8"])
@pytest.mark.parametrize("method", ["symmetric", "dual"])
def test_beyond_the_memory_budget_it_streams_with_the_same_results(
    method: str,
    number_format: str,
    transport: Transport,
    dual: Transport,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(leaves, "_SET_VALUES", 4000)
    monkeypatch.setattr(truncation, "_SUMMED_VALUES", 7000)
    acquired = dual
    if method == "symmetric":  # divided into sets of the size above
        assert isinstance(transport, HierarchicalTransport)
        rows, sets = transport.level_rows, list(transport.leaf_sets)
        acquired = HierarchicalTransport.from_leaf_sets(transport.tree, 3, rows, sets)
        assert len(acquired.pack()[0]) > 20
    path = tmp_path / "transport.zarr"
    save_transport(acquired, path, number_format)
    loaded, streamed = open_transport(path), open_transport(path, memory_budget=10_000)
    batch = np.concatenate([PATTERNS] * 4)  # more than one batch
    for light in (PATTERNS[:1], batch):
        np.testing.assert_array_equal(streamed.relight_batch(light), loaded.relight_batch(light))
    np.testing.assert_array_equal(
        streamed.truncate(3).relight(PATTERNS[0]), loaded.truncate(3).relight(PATTERNS[0])
    )
    assert streamed.nbytes == loaded.nbytes
    for chunk in path.glob("*/c.*"):
        chunk.unlink()
    loaded.relight(PATTERNS[0])
    with pytest.raises(IntegrityError, match="missing, truncated or altered"):
        streamed.relight(PATTERNS[0])


def test_results_and_bytes_are_the_same_on_any_number_of_threads(
    transport: Transport, tmp_path: Path
) -> None:
    results = []
    threads = numba.config.NUMBA_NUM_THREADS
    try:
        for count in (1, threads):
            numba.set_num_threads(count)
            path = tmp_path / f"{count}.zarr"
            save_transport(transport, path, "uint8")
            opened = open_transport(path)
            images = [opened.relight_batch(np.repeat(PATTERNS[:1], n, 0)) for n in (1, 3, 20)]
            results.append((images, contents(path)))
    finally:
        numba.set_num_threads(threads)
    for first, last in zip(results[0][0], results[-1][0], strict=True):
        np.testing.assert_array_equal(first, last)
    assert results[0][1] == results[-1][1]


@pytest.mark.parametrize("shape", [(16, 16), (1, 40), (2, 7, 9)])
@pytest.mark.parametrize("count", [1, 2, 20])
def test_skipping_dark_blocks_does_not_change_images(shape: tuple[int, ...], count: int) -> None:
    transport, matrices = random_transport(shape, 3, seed=count)
    random = np.random.default_rng(0)
    rays = matrices.shape[1]
    for lit in (0, 1, 3):
        patterns = np.zeros((count, rays))
        for pattern in patterns:
            pattern[random.choice(rays, lit, replace=False)] = random.standard_normal(lit)
        expected = np.einsum("crn,pn->prc", matrices, patterns)
        images = transport.relight_batch(patterns.reshape(count, *shape)).reshape(expected.shape)
        np.testing.assert_allclose(images, expected, atol=1e-5 * np.abs(matrices).max())
