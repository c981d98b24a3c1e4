"""Pictures of a coaxial rig in a wrong order or orientation."""

from __future__ import annotations

import numpy as np
import pytest

from rfpipe.pictures.order import TURNS, misplaced

RANDOM = np.random.default_rng(4)
SHOWN = (RANDOM.random((10, 16, 16)) < 0.5).astype(np.float32)
SHOWN[0] = np.kron(np.eye(2), np.ones((8, 8)))
SHOWN[1] = SHOWN[9] = 1 - SHOWN[0]
SHOWN[2] = 0
LIGHT = RANDOM.uniform(0.2, 1, (16, 16)) * (0.9 * SHOWN + 0.1 * SHOWN.mean((1, 2), keepdims=True))


@pytest.mark.parametrize(
    ("takes", "message"),
    [
        ([2, 3, 4, 6, 5, 7, 8], ["5 shows the pattern of 6", "6 shows the pattern of 5"]),
        ([2, 3, 4, 6, 6, 7, 8], ["5 shows the pattern of 6"]),
        ([2, 3, 4, 2, 6, 7, 8], ["5 shows none of these patterns"]),
        ([4, 3, 4, 5, 6, 7, 8], ["2 isn't evenly lit, or dark"]),
        (range(2, 9), []),
    ],
)
def test_exchanged_and_copied_pictures_are_named(takes: list[int], message: list[str]) -> None:
    assert misplaced(SHOWN, "0123456789", LIGHT[[0, 1, *takes, 9]]) == message


@pytest.mark.parametrize("turn", list(TURNS)[1:])
def test_messages_about_turned_pictures_name_the_rotation(turn: str) -> None:
    (inverse,) = (
        name
        for name, transform in TURNS.items()
        if (transform(TURNS[turn](LIGHT[3])) == LIGHT[3]).all()
    )
    turned = np.stack([TURNS[turn](light) for light in LIGHT])
    assert misplaced(SHOWN, "0123456789", turned) == [
        f"all pictures fit when they are {inverse}: turn them"
    ]
