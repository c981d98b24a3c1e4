"""The truncation of a multilevel transport by hand."""

import numpy as np

from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.pairs import PairSet


def pair_set(level: int, *pairs: tuple[int, int, float]) -> PairSet:
    """Pairs (block, pixel, value) of a single channel."""
    block, pixel, value = zip(*pairs, strict=True)
    return PairSet(
        level, np.array(block, np.int32), np.array(pixel, np.int32), np.array([value], np.float32)
    )


def test_truncation_adds_up_what_lies_below() -> None:
    sets = [pair_set(0, (0, 0, 16)), pair_set(1, (1, 0, 8)), pair_set(2, (0, 1, 3), (15, 1, 5))]
    transport = MultilevelTransport((1, 2), (4, 4), 1, [], sets)
    pair_sets = transport.truncate(1).pair_sets
    assert [pairs.level for pairs in pair_sets] == [0, 1]
    assert pair_sets[1].block.tolist() == [0, 1, 3]
    assert pair_sets[1].pixel.tolist() == [1, 0, 1]
    assert pair_sets[1].values.tolist() == [[3.0, 8.0, 5.0]]
    root = transport.truncate(0).pair_sets
    assert [pairs.level for pairs in root] == [0]
    assert root[0].values.tolist() == [[24.0, 8.0]]
    assert transport.truncate(2) is transport
