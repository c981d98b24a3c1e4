"""Pictures of a coaxial rig that show something else than their patterns."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rfpipe.pictures.order import TURNS, misplaced

RANDOM = np.random.default_rng(4)
MARKER = np.kron([[1, 0], [0, 1]], np.ones((1, 8, 8)))
PATTERNS = np.concatenate(
    [
        MARKER,
        1 - MARKER,
        np.zeros_like(MARKER),
        np.ones_like(MARKER),
        RANDOM.random((6, 16, 16)) < 0.5,
    ]
).astype(np.float32)
WHITE = RANDOM.uniform(0.2, 1, (16, 16))
LIGHT = WHITE * (0.7 * PATTERNS + 0.3 * PATTERNS.mean(axis=(1, 2), keepdims=True)) + 0.1


def said(takes: list[int], turn: str = "", turned: Any = ()) -> list[str]:
    light = LIGHT[takes]
    for index in turned:
        light[index] = TURNS[turn](light[index])
    return misplaced(PATTERNS, [*"0123456789"], light, np.full_like(light, 1e-6))


@pytest.mark.parametrize(
    ("takes", "message"),
    [
        ([2, 3, 4, 5, 7, 6, 8, 9], ["6 shows the pattern of 7", "7 shows the pattern of 6"]),
        ([2, 3, 4, 5, 7, 7, 8, 9], ["6 shows the pattern of 7"]),
        ([2, 3, 4, 5, 3, 7, 8, 9], ["6 shows none of these patterns"]),
        ([4, 3, 4, 5, 6, 7, 8, 9], ["2 isn't evenly lit"]),
        (range(2, 10), []),
    ],
)
def test_exchanged_and_copied_pictures_are_named(takes: list[int], message: list[str]) -> None:
    assert said([0, 1, *takes]) == message


@pytest.mark.parametrize("turn", list(TURNS)[1:])
def test_turned_pictures_say_how_they_fit(turn: str) -> None:
    (back,) = (name for name, how in TURNS.items() if (how(TURNS[turn](WHITE)) == WHITE).all())
    assert said([*range(10)], turn, range(10)) == [
        f"all pictures fit when they are {back}: turn them"
    ]
    assert said([*range(10)], turn, [5]) == ["5 shows none of these patterns"]
