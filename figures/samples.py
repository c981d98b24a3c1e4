"""Fig. 3.7: two more dual images, from a projector aside of the camera and above."""

from __future__ import annotations

from figures.common import Items, Picture, Size, aside, cost, percent, size_of
from figures.relit import relit
from rfpipe.report.drawing import Panel, draw

_SCENES = {"top": ("glossy_metal", 22.0, 12.0), "bottom": ("foreshortened", -8.0, 14.0)}


def items(size: Size) -> Items:
    """Acquire gloss and rough metal in a box, and print, rings and checks at grazing angles."""
    rows, captions = [], []
    for place, (name, right, up) in _SCENES.items():
        scene = aside(size, name, right, up)
        drawn = relit(scene)
        rows.append([Panel(drawn.truths["primal"], "primal", "", drawn.white("primal")),
                     *drawn.row("dual")])  # fmt: skip
        captions.append(f"{name}: {drawn.result.patterns} patterns, {percent(drawn.error('dual'))}")
        yield cost("3.1", f"Fig. 3.7, {place}", scene, drawn.result, drawn.error("dual"))
    caption = f"Errors of the dual pictures: {'; '.join(captions)}. {size_of(scene)}"
    thesis = (
        "the dual image shows what the camera hardly sees, such as detail on a pillar that is "
        "foreshortened to it."
    )
    yield Picture("fig_3_7", "Fig. 3.7", thesis, caption, draw(rows))
