"""README's opening picture, the bottle of Fig. 3.6: ``python -m figures.opening bottle.png``."""

from __future__ import annotations

import io
import sys
from pathlib import Path

from figures.common import acquired, dual_truth, error, exposure, matte, percent, seen
from rfpipe.config import SceneSettings
from rfpipe.report.drawing import Panel, draw
from rfpipe.scenes import scene_from_config
from rfpipe.store.files import write_atomically


def main(path: str, side: int = 128, samples: int = 1024) -> None:
    """Acquire the bottle by dual photography; draw it from both sides, in stripes of light.

    Parameters
    ----------
    path : str
        The picture to write, PNG.
    side : int
        Pixels of the camera's and the projector's pictures, both square.
    samples : int
        Paths of light a pixel, of the scene's recording.
    """
    settings = SceneSettings.of("mitsuba", scene="bottle", shape=(side, side), samples=samples)
    scene = scene_from_config(settings)
    result, _ = acquired(scene, "dual")
    stripes, panels = matte((side, side)), []
    sides = ("camera", result.transport, seen), ("projector", result.transport.T, dual_truth)
    for name, transport, true in sides:
        image, truth = transport.relight(stripes), true(scene, stripes)
        title = f"what the {name} sees: error {percent(error(image, truth))}"
        panels.append(Panel(image, title, "", exposure(truth)))
    grain = percent(scene.recording.noise["half_lit"]["whole"])
    print(f"{path}: {result.patterns} patterns; the truth is recorded with a grain of {grain}")
    image = io.BytesIO()
    draw([panels], width=4.2).savefig(image, format="png")
    write_atomically(Path(path), image.getvalue())


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
