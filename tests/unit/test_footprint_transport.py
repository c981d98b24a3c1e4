"""Transport as footprints and the light between functions of two sides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array
from tests.helpers import dense

from rfpipe.testing import dot_test
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.footprints import FootprintTransport

ROWS = [{"level": level, "patterns": 3} for level in range(3)]
SHAPES = [((1, 1), (1, 1)), ((3, 5), (7, 2)), ((2, 3, 4), (5, 5))]


def parts(camera: int, projector: int, channels: int) -> dict[str, np.ndarray]:
    """D, L, S, R, f and g, dense: (C, M, N), (M, 4), (C, 4, 6), (N, 6), (C, M), (C, N)."""
    random = np.random.default_rng(1)

    def sparse(rows: int, columns: int) -> np.ndarray:
        return random_array((rows, columns), density=0.5, rng=random).toarray()

    def many(matrix: np.ndarray) -> np.ndarray:
        return matrix * random.standard_normal((channels, 1, 1))

    return {
        "footprints": many(sparse(camera, projector)),
        "left": sparse(camera, 4),
        "cores": many(sparse(4, 6)),
        "right": sparse(projector, 6),
        "camera_factor": random.random((channels, camera)),
        "projector_factor": random.random((channels, projector)),
    }


def made(camera: tuple[int, ...], projector: tuple[int, ...], channels: int = 3):
    """A transport, and its matrices."""
    own = parts(int(np.prod(camera)), int(np.prod(projector)), channels)
    held: dict[str, np.ndarray] = {}
    for name, matrix in own.items():
        if name.endswith("factor"):
            held[name] = matrix.astype(np.float32)
            continue
        planes = matrix if matrix.ndim == 3 else matrix[None]
        kept = [csr_array(plane) for plane in planes]
        values = np.stack([plane.data for plane in kept]).astype(np.float32)
        held[name] = values if matrix.ndim == 3 else values[0]
        held[f"{name}_columns"] = kept[0].indices.astype(np.int32)
        held[f"{name}_starts"] = kept[0].indptr.astype(np.int32)
    smooth = own["left"] @ own["cores"] @ own["right"].T
    expected = (
        own["footprints"]
        + own["camera_factor"][:, :, None] * smooth * own["projector_factor"][:, None]
    )
    return FootprintTransport(camera, projector, channels, ROWS, held), expected


@pytest.mark.parametrize("shapes", SHAPES)
@pytest.mark.parametrize("channels", [1, 3])
def test_it_is_the_sum_and_product_that_its_arrays_say(shapes, channels: int) -> None:
    transport, expected = made(*shapes, channels)
    np.testing.assert_allclose(dense(transport), expected, atol=1e-5 * np.abs(expected).max())
    dot_test(transport)
    assert transport.forward(np.ones((2, channels, expected.shape[2]), np.float32), range(
        channels
    )).dtype == np.float32  # fmt: skip


def test_each_channel_has_its_own_light() -> None:
    transport, _ = made((3, 5), (7, 2))
    picture = np.random.default_rng(1).random((7, 2, 3))
    together = transport.relight(picture)
    for channel in range(3):
        alone = transport.channel(channel) @ picture[..., channel].ravel()
        np.testing.assert_allclose(together[..., channel].ravel(), alone, rtol=1e-5, atol=1e-6)


def test_its_direct_light_is_the_footprints() -> None:
    transport, _ = made((3, 5), (7, 2))
    own = parts(15, 14, 3)["footprints"]
    np.testing.assert_allclose(dense(transport.direct()), own, atol=1e-6 * np.abs(own).max())


@pytest.mark.parametrize("number_format", ["float32", "uint16", "uint8"])
@pytest.mark.parametrize("shapes", SHAPES)
def test_the_store_keeps_it_unrounded(shapes, number_format, tmp_path: Path) -> None:
    transport, _ = made(*shapes)
    path = tmp_path / "transport.zarr"
    digest = save_transport(transport, path, number_format)
    stored = open_transport(path)
    assert isinstance(stored, FootprintTransport)
    assert (stored.camera_shape, stored.projector_shape) == shapes
    assert stored.channels == 3
    assert stored.level_rows == ROWS
    np.testing.assert_array_equal(dense(stored), dense(transport))
    files = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    assert stored.nbytes == files
    assert save_transport(stored, tmp_path / "again", number_format) == digest


def test_bytes_are_those_of_its_arrays() -> None:
    transport, _ = made((3, 5), (7, 2))
    arrays, about = transport.pack()
    assert transport.nbytes == sum(array.nbytes for array in arrays.values())
    assert about["kind"] == "footprints"
    assert {array.dtype.name for array in arrays.values()} == {"float32", "int32"}
