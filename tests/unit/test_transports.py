"""All kinds of transport: the matrix of their arrays, and storage."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array, random_array
from tests.property.test_hierarchical import random_transport
from tests.rigs.known_matrix import dense

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.testing import dot_test
from rfpipe.transport import Transport, open_transport, save_transport
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.footprints import FootprintTransport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.multiscale import (
    MultiscaleBasis,
    MultiscaleTransport,
    cells,
    functions_over,
)
from rfpipe.transport.responses import Responses
from rfpipe.transport.sum import SumTransport
from rfpipe.transport.wavelet import Cells, WaveletTransport

ROWS = [{"level": level, "patterns": 3} for level in range(9)]
CAMERA, PROJECTOR, COAXIAL = (3, 5), (2, 4, 3), (6, 7)
M, N = 15, 24
Made = tuple[Transport, NDArray[np.float64]]


def draw(*shape: int, seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng((seed, *shape)).standard_normal(shape).astype(np.float32)


def scan() -> Made:
    matrix = draw(3, M, N)
    return DenseTransport(CAMERA, PROJECTOR, 3, ROWS[:1], {"matrix": matrix}), matrix


def leaves(shape: tuple[int, ...] = COAXIAL) -> Made:
    transport, matrices = random_transport(shape, 3, seed=5)
    transport.level_rows = ROWS
    return transport, matrices


def pairs() -> Made:
    """Return responses of pixels to single rays and to blocks, distributed uniformly."""
    tree, sets, matrix = BlockTree(RayDomain(PROJECTOR)), [], np.zeros((3, M, N))
    for level in (1, tree.n_levels - 1):
        block, pixel = (index.ravel() for index in np.indices((tree.n_blocks(level), M)))
        values = draw(3, len(block), seed=level)
        sets.append(Responses(level, block.astype(np.int32), pixel.astype(np.int32), values))
        block_of_ray, sizes = tree.labels(level).ravel(), np.diff(tree.starts[level])
        matrix += (values.reshape(3, -1, M) / sizes[:, None])[:, block_of_ray].swapaxes(1, 2)
    return MultilevelTransport(CAMERA, PROJECTOR, 3, ROWS, sets), matrix


def terms() -> Made:
    arrays = {"left": draw(3, 2, M), "right": draw(3, 2, N), "strengths": draw(3, 2)}
    expected = np.einsum("cr,crm,crn->cmn", arrays["strengths"], arrays["left"], arrays["right"])
    return LowRankTransport(CAMERA, PROJECTOR, 3, ROWS, arrays), expected


def diagonal() -> Made:
    arrays = {"left": draw(3, 2, 42), "strengths": draw(3, 2), "diagonal": draw(3, 42)}
    expected = np.einsum("cr,crm,crn->cmn", arrays["strengths"], arrays["left"], arrays["left"])
    expected += arrays["diagonal"][:, :, None] * np.eye(42)
    return LowRankTransport(COAXIAL, COAXIAL, 3, ROWS, arrays), expected


def footprints() -> Made:
    arrays: dict[str, NDArray] = {"camera_factor": draw(3, M), "projector_factor": draw(3, N)}
    matrices = {}
    for name, shape in {
        "footprints": (M, N), "left": (M, 4), "cores": (4, 6), "right": (N, 6),
    }.items():  # fmt: skip
        matrix = csr_array(random_array(shape, density=0.5, rng=np.random.default_rng(1)))
        per_channel = name in ("footprints", "cores")
        arrays[name] = draw(3, matrix.nnz) if per_channel else matrix.data.astype(np.float32)
        arrays[f"{name}_columns"] = matrix.indices.astype(np.int32)
        arrays[f"{name}_starts"] = matrix.indptr.astype(np.int32)
        planes = [
            csr_array((data, matrix.indices, matrix.indptr), shape=shape).toarray()
            for data in np.atleast_2d(arrays[name])
        ]
        matrices[name] = np.stack(planes)
    smooth = matrices["left"] @ matrices["cores"] @ matrices["right"].swapaxes(1, 2)
    smooth *= arrays["camera_factor"][:, :, None] * arrays["projector_factor"][:, None]
    transport = FootprintTransport(CAMERA, PROJECTOR, 3, ROWS, arrays)
    np.testing.assert_allclose(dense(transport.direct()), matrices["footprints"], atol=1e-5)
    return transport, matrices["footprints"] + smooth


def multiscale(shape: tuple[int, ...] = COAXIAL, side: int = 1) -> Made:
    grid = Cells(shape, side)
    functions = [functions_over(s, np.ones(cells(grid.grid_shape, s), np.bool_)) for s in (4, 2)]
    basis = MultiscaleBasis(grid.grid_shape, np.concatenate(functions))
    first, second = pairs = np.stack(basis.pairs)[:, ::2]
    arrays = {"factor": draw(3, 42), "functions": basis.functions, "pairs": pairs}
    arrays |= {"side": np.array([side], np.int32), "cores": draw(3, len(first))}
    cores = np.zeros((3, len(basis), len(basis)))
    cores[:, first, second] = cores[:, second, first] = arrays["cores"]
    weighted = arrays["factor"][:, :, None] * basis.weights.toarray()[grid.of_ray]
    transport = MultiscaleTransport(shape, shape, 3, ROWS, arrays)
    return transport, weighted @ cores @ weighted.swapaxes(1, 2)


def multiscale_over_cells() -> Made:
    return multiscale(side=2)


def wavelets() -> Made:
    grid = Cells(COAXIAL, 2)
    pairs = np.sort(np.random.default_rng(3).integers(0, grid.haar.size, (2, 60)), axis=0)
    pairs = np.unique(pairs, axis=1).astype(np.int32)
    arrays = {"side": np.array([2], np.int32), "factor": draw(3, 42), "pairs": pairs}
    arrays["cores"] = draw(3, pairs.shape[1])
    cores = np.zeros((3, grid.haar.size, grid.haar.size))
    cores[:, pairs[0], pairs[1]] = cores[:, pairs[1], pairs[0]] = arrays["cores"]
    wavelets = grid.haar.inverse(np.eye(grid.haar.size, dtype=np.float32))
    weighted = arrays["factor"][:, :, None] * wavelets[grid.of_ray]
    return WaveletTransport(
        COAXIAL, COAXIAL, 3, ROWS, arrays
    ), weighted @ cores @ weighted.swapaxes(1, 2)


def total() -> Made:
    parts = [make() for make in (diagonal, leaves, multiscale)]
    inner = SumTransport([part for part, _ in parts[:2]], ROWS)
    return SumTransport([inner, parts[2][0]], ROWS), sum(matrix for _, matrix in parts)


KINDS = [scan, leaves, pairs, terms, diagonal, footprints, multiscale]
KINDS += [multiscale_over_cells, wavelets, total]
EACH = pytest.mark.parametrize("make", KINDS, ids=lambda make: make.__name__)


@EACH
def test_a_transport_equals_the_matrix_of_its_arrays(make: Callable[[], Made]) -> None:
    transport, expected = make()
    atol = 1e-5 * float(np.abs(expected).max())
    np.testing.assert_allclose(dense(transport), expected, atol=atol)
    np.testing.assert_allclose(transport.T.toarray(), expected.swapaxes(1, 2), atol=atol)
    dot_test(transport)
    patterns = draw(20, *transport.projector_shape, 3)  # more than one batch
    images = transport.relight_batch(patterns)
    assert images.dtype == np.float32
    lit = np.einsum("cmn,pnc->pmc", expected, patterns.reshape(20, -1, 3))
    np.testing.assert_allclose(images.reshape(lit.shape), lit, atol=30 * atol)
    arrays, _ = transport.pack()
    assert transport.nbytes == sum(array.nbytes for array in arrays.values())


@EACH
def test_light_between_patterns_equals_that_of_the_matrix(make: Callable[[], Made]) -> None:
    transport, matrix = make()
    received, sent = (
        csr_array(draw(rays, n)) for rays, n in zip(matrix.shape[1:], (3, 70), strict=True)
    )
    expected = received.toarray().T @ matrix[1] @ sent.toarray()
    result = transport.between(received, sent, 1)
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, expected, atol=1e-4 * np.abs(expected).max())


@EACH
@pytest.mark.parametrize("number_format", ["float32", "uint16", "uint8"])
def test_a_stored_transport_is_restored(
    make: Callable[[], Made], number_format, tmp_path: Path
) -> None:
    transport, _ = make()
    path, pattern = tmp_path / "transport.zarr", np.abs(draw(*transport.projector_shape))
    digest = save_transport(transport, path, number_format, scene="test")
    opened, streamed = open_transport(path), open_transport(path, memory_budget=0)
    assert type(opened) is type(transport)
    for name in ("camera_shape", "projector_shape", "channels", "level_rows"):
        assert getattr(opened, name) == getattr(transport, name)
    assert opened.nbytes == sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    exact = transport.relight(pattern)
    rounds = make in (leaves, pairs, total) and number_format != "float32"
    bound = {"uint16": 1e-4, "uint8": 2e-2}[number_format] if rounds else 0
    assert np.abs(opened.relight(pattern) - exact).max() <= bound * np.abs(exact).max()
    np.testing.assert_array_equal(streamed.relight(pattern), opened.relight(pattern))
    assert save_transport(opened, tmp_path / "again", number_format, scene="test") == digest
