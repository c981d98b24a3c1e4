"""Write fig_3_1.json: the walk-through of [thesis Fig. 3.1] and the patterns shown for it.

Run it with ``python -m tests.golden.make_fig_3_1`` when a change of patterns is intended, and
check the new ones against the caption; ``pytest tests/golden`` checks the counts only.

The 8x8 projector lights 64 camera pixels, ray by ray. Two things are added to reproduce the
drawing. Camera pixel 64 sees one ray each of frames 6 and 12, pixel 65 one ray each of frames 8
and 10: frames 6 and 8 light children of block 2, frames 10 and 12 children of block 4, so that
blocks 2 and 4 conflict a level above. No pixel sees block 9 in the lower left.
"""

import json
from pathlib import Path

import numpy as np
from tests.rigs.known_matrix import acquire_matrix

from rfpipe.methods.dual import Dual

PROJECTOR = (8, 8)
CAMERA = (6, 11)
# The first ray (row, column) of each 2x2 block, numbered clockwise: 6 to 9 are the children of
# block 2 in the upper left, 10 to 13 the children of block 4 in the lower right.
BLOCK_6, BLOCK_8 = (0, 0), (2, 2)
BLOCK_10, BLOCK_12 = (4, 4), (6, 6)
# Block 5 in the lower left; its children have the numbers 6 to 9, like the children of block 2.
BLOCK_9 = (6, 0)
GOLDEN = Path(__file__).with_name("fig_3_1.json")


def walk_through(conflicts: bool) -> np.ndarray:
    """Return the transport matrix (66, 64) of the walk-through."""
    matrix = np.zeros((np.prod(CAMERA), np.prod(PROJECTOR)), np.float32)
    matrix[:64] = np.eye(64)
    if conflicts:
        for pixel, blocks in ((64, (BLOCK_6, BLOCK_12)), (65, (BLOCK_8, BLOCK_10))):
            for block in blocks:
                matrix[pixel, np.ravel_multi_index(block, PROJECTOR)] = 0.5
        rows, columns = np.ogrid[BLOCK_9[0] : BLOCK_9[0] + 2, BLOCK_9[1] : BLOCK_9[1] + 2]
        matrix[:, (rows * PROJECTOR[1] + columns).ravel()] = 0
    return matrix


def shown(conflicts: bool) -> list[list[list[int]]]:
    """Return each level's pattern of each projector ray, -1 where it is dark."""
    matrix = walk_through(conflicts)
    run = acquire_matrix(Dual(), matrix, CAMERA, PROJECTOR)
    return [schedule.pattern_of_ray.tolist() for schedule in run.schedules]


if __name__ == "__main__":
    levels = {"without_conflicts": shown(conflicts=False), "with_conflicts": shown(conflicts=True)}
    GOLDEN.write_text(json.dumps(levels, separators=(",", ":")) + "\n", encoding="utf-8")
