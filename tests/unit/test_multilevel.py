"""The multilevel transport by hand, its dual images, its truncation."""

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.pairs import PairSet

CAMERA = RayDomain((1, 2))


def pair_set(level: int, *pairs: tuple[int, int, float]) -> PairSet:
    """Pairs (block, pixel, value) of a single channel."""
    block, pixel, value = zip(*pairs, strict=True)
    return PairSet(
        level, np.array(block, np.int32), np.array(pixel, np.int32), np.array([value], np.float32)
    )


def transport_of(
    *pair_sets: PairSet,
    projector: tuple[int, ...] = (4, 4),
    camera: RayDomain = CAMERA,
    channels: int = 1,
) -> MultilevelTransport:
    return MultilevelTransport(camera.shape, projector, channels, [], list(pair_sets))


@pytest.fixture
def transport() -> MultilevelTransport:
    return transport_of(
        pair_set(0, (0, 0, 16.0)), pair_set(1, (1, 0, 8.0)), pair_set(2, (0, 1, 3.0), (15, 1, 5.0))
    )


def test_a_level_acts_on_the_mean_over_its_blocks(transport: MultilevelTransport) -> None:
    pattern = np.zeros((4, 4))
    pattern[0, 3] = 1.0  # a sixteenth of the root, a quarter of the upper right block
    np.testing.assert_array_equal(transport.relight(pattern)[0, :, 0], [1.0 + 2.0, 0.0])
    np.testing.assert_array_equal(transport.relight(np.ones((4, 4)))[0, :, 0], [24.0, 8.0])


def test_the_transpose_spreads_a_value_over_its_block(transport: MultilevelTransport) -> None:
    expected = np.ones((4, 4))
    expected[:2, 2:] += 2.0
    np.testing.assert_array_equal(transport.T.relight(np.array([[1.0, 0.0]]))[..., 0], expected)
    expected = np.zeros((4, 4))
    expected[0, 0], expected[3, 3] = 3.0, 5.0
    np.testing.assert_array_equal(transport.T.relight(np.array([[0.0, 1.0]]))[..., 0], expected)


def test_truncation_adds_up_what_lies_below(transport: MultilevelTransport) -> None:
    pair_sets = transport.truncate(1).pair_sets
    assert [pairs.level for pairs in pair_sets] == [0, 1]
    assert pair_sets[1].block.tolist() == [0, 1, 3]
    assert pair_sets[1].pixel.tolist() == [1, 0, 1]
    assert pair_sets[1].values.tolist() == [[3.0, 8.0, 5.0]]
    root = transport.truncate(0).pair_sets
    assert [pairs.level for pairs in root] == [0]
    assert root[0].values.tolist() == [[24.0, 8.0]]
    same = transport.truncate(2)
    np.testing.assert_array_equal(same.relight(np.eye(4)), transport.relight(np.eye(4)))


def test_a_store_names_its_arrays_by_level(transport: MultilevelTransport) -> None:
    arrays, about = transport.pack()
    assert set(arrays) == {
        f"level_{level:02d}_{part}" for level in range(3) for part in ("block", "pixel", "values")
    }
    assert about["symmetric"] is False
