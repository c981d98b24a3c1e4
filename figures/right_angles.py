"""Fig. 3.10: camera and projector at right angles, and a mirror."""

from __future__ import annotations

from figures.common import Items, Picture, Size, percent, physical, size_of
from figures.relit import relit
from rfpipe.report.drawing import Panel, draw


def items(size: Size) -> Items:
    """Acquire a block and its reflection, the camera above, the projector in front."""
    scene = physical(size, "right_angles")
    drawn = relit(scene)
    primal = Panel(drawn.truths["primal"], "primal", "", drawn.white("primal"))
    caption = (
        f"{percent(drawn.coarse)} of the dual picture's light is stored at levels coarser than a "
        f"pixel, which blurs it there; its error is {percent(drawn.error('dual'))}. "
        f"{size_of(scene)}"
    )
    thesis = (
        "with camera and projector at right angles much of the dual image rests on coarse levels "
        "and is blurred, yet the mirror's reflection is there."
    )
    figure = draw([[primal, *drawn.row("dual")]])
    yield Picture("fig_3_10", "Fig. 3.10", thesis, caption, figure)
