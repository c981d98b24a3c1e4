"""Fig. 3.1: patterns of an 8 x 8 projector, level by level, without and with conflicts."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from figures.common import Items, Picture, Size, Watched
from rfpipe import OperatorRig, acquire
from rfpipe.report.drawing import new_figure


def items(_size: Size) -> Items:
    """Acquire an identity, and one with two camera pixels that see blocks 2 and 4."""
    figure, axes = new_figure(2, 4, (8.0, 4.4))
    counts = {}
    for row, case in zip(axes, ("without", "with"), strict=True):
        rig = Watched(OperatorRig(_matrix(conflicts=case == "with"), (6, 11), (8, 8)))
        counts[case] = acquire(rig, "dual", progress=False).patterns
        frame = 0
        for level, axis in enumerate(row):
            frames = np.zeros((8, 8), np.int64)
            for pattern in rig.levels[level]:
                frame += 1
                frames[pattern > 0] = frame
            _draw(axis, frames, 8 >> level)
            axis.set_title(f"level {level + 1}", fontsize=8.5, pad=3)
        row[0].set_ylabel(f"{case} conflicts:\n{counts[case]} patterns", fontsize=8.5)
    caption = (
        f"Here {counts['without']} patterns without conflicts and {counts['with']} with them. The "
        "number in a block is that of the frame that lights it. Above, no camera pixel sees two "
        "blocks; below, two pixels see light of block 2 (upper left) as well as of block 4 (lower "
        "right), so that their children are never lit in one frame."
    )
    thesis = (
        "a projector of 8 by 8 pixels takes 21 patterns with the conflicts drawn there and 13 "
        "without any, in place of 64."
    )
    yield Picture("fig_3_1", "Fig. 3.1", thesis, caption, figure)


def _matrix(*, conflicts: bool) -> NDArray[np.float64]:
    """Transport (66, 64): a ray a pixel, and two pixels that see rays of blocks 2 and 4."""
    matrix = np.zeros((66, 64))
    matrix[:64] = np.eye(64)
    if conflicts:
        for pixel, rays in ((64, ((0, 0), (6, 6))), (65, ((2, 2), (4, 4)))):
            for row, column in rays:
                matrix[pixel, 8 * row + column] = 0.5
    return matrix


def _draw(axis: Any, frames: NDArray[np.int64], length: int) -> None:
    """Draw a level: colours for frames, and the frame's number in each block."""
    axis.set(xticks=[], yticks=[])
    axis.imshow(frames, cmap="Pastel1", vmin=1, vmax=max(int(frames.max()), 9))
    for top in range(0, 8, length):
        for column in range(0, 8, length):
            middle = (length - 1) / 2
            axis.text(column + middle, top + middle, str(frames[top, column]), ha="center",
                      va="center", fontsize=6.5 if length == 1 else 8.5)  # fmt: skip
