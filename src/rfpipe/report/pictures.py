"""Pictures of a scene: floodlit and relit by each method, beside truth or captured pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.relighting import picture_errors
from rfpipe.report.drawing import UNLIT_GAIN, Drawn, Panel, draw, unlit_gain
from rfpipe.report.inputs import Inputs, Run, SeedGroup
from rfpipe.report.page import Illustration
from rfpipe.report.text import number, percent, words
from rfpipe.stages.evaluate import relative_rms

_SHOWN = "horizontal_bar"  # crosses the edge of two planes, where indirect light shows best
_FLOODLIT = "floodlit"
_COLUMNS = 6  # pictures of a scene, at most, the floodlit one among them
_WIDTH = 1.75  # inches of a picture
_LABEL = 20  # signs of a method's name on a line


@dataclass(frozen=True)
class Compared:
    """A picture as a method relights it.

    Attributes
    ----------
    name : str
    relit : ndarray of float, shape (H, W, C)
    reference : ndarray of float, shape (H, W, C), or None
        Truth, or the picture that was captured, if there is one.
    error, indirect : float or None
        Error of the relit picture, and of its indirect light.
    gain : ndarray of float, shape (H, W), or float
        Factor by which pixels are shown brighter.
    """

    name: str
    relit: NDArray[Any]
    reference: NDArray[Any] | None = None
    error: float | None = None
    indirect: float | None = None
    gain: NDArray[Any] | float = 1.0

    @property
    def below(self) -> str:
        """The errors in words."""
        known = (it is not None and np.isfinite(it) for it in (self.error, self.indirect))
        is_known, is_indirect_known = known
        texts = [f"error {percent(self.error)} %"] if is_known else []
        if is_indirect_known:
            indirect = f"error of indirect light {percent(self.indirect)} %"
            texts.append(indirect if self.indirect else "no indirect light")
        return "\n".join(texts)


def scene_pictures(inputs: Inputs, group: SeedGroup) -> Illustration:
    """Show a scene's pictures from left to right, and its methods from top to bottom.

    Of scenes that differ by their seeds the first one is shown.
    """
    scene = group.scenes[0]
    runs = inputs.of_scene(scene)
    by_method = [[*compared_pictures(run)] for run in runs]
    white = runs[0].white
    rows: list[Sequence[Drawn]] = []
    left: list[str] = []
    light: dict[str, NDArray[Any]] = {}
    if any(one.reference is not None for one in by_method[0]):
        rows.append([_reference_panel(one, white) for one in by_method[0]])
        left.append("truth" if runs[0].has_truth else "captured")
    for run, pictures in zip(runs, by_method, strict=True):
        names = ["" if rows else it.name for it in pictures]
        panels = [
            Panel(it.relit, name, it.below, white, it.gain)
            for name, it in zip(names, pictures, strict=True)
        ]
        errors = [_difference(panel, it) for panel, it in zip(panels, pictures, strict=True)]
        rows += [panels, errors] if any(errors) else [panels]
        name = textwrap.fill(inputs.title(run.method), _LABEL)
        left += [name, "difference"] if any(errors) else [name]
        light |= _kept_light(run, pictures)
    figure = draw(rows, _WIDTH, left)
    name = scene if len(group.scenes) == 1 else f"{group.title}; of them {scene}"
    return Illustration(name, _caption(inputs, runs, white), f"scene_{scene}", figure, light)


def compared_pictures(run: Run) -> Iterator[Compared]:
    """Yield the pictures of a run that a report shows, the floodlit one first."""
    floodlit = run.read("floodlit_truth" if run.has_truth else "floodlit_captured")
    relit = run.read("floodlit_relit")
    error = relative_rms(np.nan_to_num(relit), np.nan_to_num(floodlit))
    yield Compared(_FLOODLIT, run.middle(relit), run.middle(floodlit), error)
    if run.has_truth:
        yield from _beside_truth(run, floodlit)
    elif run.verified_images is not None:
        images = run.verified_images
        shown = range(min(_COLUMNS - 1, len(run.verified["pictures"])))
        relit, captured = (images.read(name) for name in ("relit", "captured"))
        for index in shown:
            about = run.verified["pictures"][index]
            pair = run.middle(relit[index]), run.middle(captured[index])
            yield Compared(about["name"], *pair, about["error"])
    else:
        for name, image in zip(run.facts["names"], run.read("relit"), strict=True):
            yield Compared(words(name), run.middle(image))


def _beside_truth(run: Run, floodlit: NDArray[Any]) -> Iterator[Compared]:
    """Yield the reference pictures of a run whose truth is known."""
    relit, truth, patterns = (run.read(name) for name in ("relit", "truth", "patterns"))
    dark = patterns == 0 if run.is_coaxial else None
    total, indirect = picture_errors(relit, truth, patterns, floodlit, dark)
    names = run.facts["names"][: _COLUMNS - 1]
    for index, name in enumerate(names):
        is_dark = (patterns[index] == 0).any()
        gain: Any = 1.0
        if run.is_coaxial and not run.settings.is_light_field:
            gain = unlit_gain(patterns[index])
        pair = run.middle(relit[index]), run.middle(truth[index])
        unlit = float(indirect[index]) if is_dark else None
        yield Compared(words(name), *pair, float(total[index]), unlit, gain)


def _reference_panel(picture: Compared, white: float) -> Drawn:
    if picture.reference is None:
        return None
    return Panel(picture.reference, picture.name, white=white, gain=picture.gain)


def _difference(panel: Panel, picture: Compared) -> Drawn:
    if picture.reference is None:
        return None
    reference = Panel(picture.reference, white=panel.white, gain=picture.gain)
    return panel.less(reference).untitled()


def _kept_light(run: Run, pictures: Sequence[Compared]) -> dict[str, NDArray[Any]]:
    """Return the radiance that lies beside the page.

    Floodlit, a picture's truth, and it relit; of a scene with nothing to compare with all pictures
    relit.
    """
    floodlit, *others = pictures
    if others and others[0].reference is None:
        names = [it.name.replace(" ", "_") for it in others]
        pairs = zip(names, others, strict=True)
        relit = {f"{name}_{run.method}": picture.relit for name, picture in pairs}
        return {_FLOODLIT: np.asarray(floodlit.reference), **relit}
    wished = words(_SHOWN)
    shown = next((it for it in others if it.name == wished), others[0] if others else floodlit)
    return {
        _FLOODLIT: np.asarray(floodlit.reference),
        "truth" if run.has_truth else "captured": np.asarray(shown.reference),
        f"relit_{run.method}": shown.relit,
    }


def _caption(inputs: Inputs, runs: Sequence[Run], white: float) -> str:
    patterns = ", ".join(
        f"{inputs.title(run.method).lower()} with {number(run.patterns)} patterns" for run in runs
    )
    first = runs[0]
    said = {
        True: "Truth, and below it each picture relit, its errors, and the difference",
        False: "As captured for verification, and as relit: errors, and the difference",
    }[first.has_truth]
    if not first.has_truth and first.verified_images is None:
        said = "The floodlit picture as captured and as relit, and the scene relit"
    brighter = ""
    if first.has_truth and first.is_coaxial and not first.settings.is_light_field:
        brighter = f" Pixels that a picture leaves dark are shown {UNLIT_GAIN} times brighter."
    return f"{said}: {patterns}. White is radiance {white:.3g}.{brighter}"
