"""The walk-through of [thesis Fig. 3.1]: counts as in its caption."""

import json

import numpy as np
import pytest
from tests.golden.make_fig_3_1 import GOLDEN, shown


@pytest.mark.parametrize(
    ("case", "counts"),
    [
        ("without_conflicts", [1, 4, 4, 4]),  # 4 log4(pq) + 1 in all
        ("with_conflicts", [1, 4, 8, 8]),
    ],
)
def test_patterns_equal_the_stored_ones(case: str, counts: list[int]) -> None:
    levels = shown(case == "with_conflicts")
    assert levels == json.loads(GOLDEN.read_text(encoding="utf-8"))[case]
    assert [np.max(level) + 1 for level in levels] == counts
