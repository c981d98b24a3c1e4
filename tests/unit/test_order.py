"""Pictures of a coaxial rig that show something else than their patterns."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.pictures.order import TURNS, Shown

RANDOM = np.random.default_rng(4)
PATTERNS = np.concatenate(
    [np.zeros((1, 16, 16)), np.ones((1, 16, 16)), RANDOM.random((6, 16, 16)) < 0.5]
)
WHITE = RANDOM.uniform(0.2, 1, (16, 16))
LIGHT = WHITE * (0.7 * PATTERNS + 0.3 * PATTERNS.mean(axis=(1, 2), keepdims=True))


def said(light: np.ndarray) -> dict[int, str]:
    names = [f"p{index}" for index in range(8)]
    shown = Shown(PATTERNS, names, light, np.full(light.shape, 1e-6), WHITE)
    return shown.impossible() | shown.misplaced()


@pytest.mark.parametrize(
    ("takes", "message"),
    [
        ([0, 1, 2, 4, 3, 5, 6, 7], {3: "shows p4", 4: "shows p3"}),
        ([0, 1, 2, 4, 4, 5, 6, 7], {3: "shows p4"}),
        ([1, 1, 2, 3, 4, 5, 6, 7], {0: "is not dark"}),
        ([0, 3, 2, 3, 4, 5, 6, 7], {1: "is not evenly lit"}),
        ([0, 1, 2, 1, 4, 5, 6, 7], {3: "shows none of these patterns"}),
        (range(8), {}),
    ],
)
def test_exchanged_and_copied_pictures_are_named(takes: list[int], message: dict) -> None:
    assert said(LIGHT[list(takes)]) == message


@pytest.mark.parametrize("turn", list(TURNS)[1:])
def test_turned_pictures_say_how_they_fit(turn: str) -> None:
    (back,) = (name for name, how in TURNS.items() if (how(TURNS[turn](WHITE)) == WHITE).all())
    light = LIGHT.copy()
    light[5] = TURNS[turn](LIGHT[5])
    assert f"fits when it is {back}" in said(light)[5]
    every = said(np.stack([TURNS[turn](picture) for picture in LIGHT]))
    assert [every[index] for index in range(2, 8)] == [f"fits when it is {back}"] * 6
