"""Pictures of a scene: floodlit and relit by each method, and true or captured pictures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.relighting import picture_errors
from rfpipe.report.drawing import UNLIT_GAIN, Drawn, Panel, draw, unlit_gain
from rfpipe.report.inputs import RelitAcquisition, ReportInputs, SeedGroup
from rfpipe.report.page import Illustration
from rfpipe.report.text import number, rounded_percent, words
from rfpipe.stages.evaluate import relative_rms

_MAIN_PICTURE = "horizontal_bar"
"""Picture whose radiance is written; it crosses the edge of two planes, where indirect light is
strongest."""

_FLOODLIT = "floodlit"
_COLUMNS = 6  # largest number of pictures of a scene, including the floodlit one
_WIDTH = 1.75  # inches of a picture
_LABEL = 20  # characters on a line of a method's name


@dataclass(frozen=True)
class Compared:
    """Picture relit by a method, with its reference.

    Attributes
    ----------
    name : str
    relit : ndarray of float, shape (H, W, C)
    reference : ndarray of float, shape (H, W, C), or None
        True or captured picture, if there is one.
    error, indirect : float or None
        Error of the relit picture, and of its indirect light.
    gain : ndarray of float, shape (H, W), or float
        Factor by which pixels are brightened.
    """

    name: str
    relit: NDArray[Any]
    reference: NDArray[Any] | None = None
    error: float | None = None
    indirect: float | None = None
    gain: NDArray[Any] | float = 1.0

    @property
    def below(self) -> str:
        """The errors as text."""
        known = (it is not None and np.isfinite(it) for it in (self.error, self.indirect))
        is_known, is_indirect_known = known
        texts = [f"error {rounded_percent(self.error)} %"] if is_known else []
        if is_indirect_known:
            indirect = f"error of indirect light {rounded_percent(self.indirect)} %"
            texts.append(indirect if self.indirect else "no indirect light")
        return "\n".join(texts)


def scene_pictures(inputs: ReportInputs, group: SeedGroup) -> Illustration:
    """Draw a scene's pictures, with a column for each pattern and rows for each method.

    Scenes that differ only in their seeds are represented by the first one.
    """
    scene = group.scenes[0]
    runs = inputs.of_scene(scene)
    by_method = [[*compared_pictures(run)] for run in runs]
    white = runs[0].white
    rows: list[Sequence[Drawn]] = []
    labels: list[str] = []
    light: dict[str, NDArray[Any]] = {}
    if any(picture.reference is not None for picture in by_method[0]):
        rows.append([_reference_panel(picture, white) for picture in by_method[0]])
        labels.append("truth" if runs[0].has_truth else "captured")
    for run, pictures in zip(runs, by_method, strict=True):
        names = ["" if rows else picture.name for picture in pictures]
        panels = [
            Panel(it.relit, name, it.below, white, it.gain)
            for name, it in zip(names, pictures, strict=True)
        ]
        errors = [_difference(panel, it) for panel, it in zip(panels, pictures, strict=True)]
        rows += [panels, errors] if any(errors) else [panels]
        name = textwrap.fill(inputs.title(run.method), _LABEL)
        labels += [name, "difference"] if any(errors) else [name]
        light |= _written_light(run, pictures)
    figure = draw(rows, _WIDTH, labels)
    name = scene if len(group.scenes) == 1 else f"{group.title}; of them {scene}"
    return Illustration(name, _caption(inputs, runs, white), f"scene_{scene}", figure, light)


def compared_pictures(run: RelitAcquisition) -> Iterator[Compared]:
    """Yield the pictures of a run for the report, the floodlit image first."""
    floodlit = run.read("floodlit_truth" if run.has_truth else "floodlit_captured")
    relit = run.read("floodlit_relit")
    error = relative_rms(np.nan_to_num(relit), np.nan_to_num(floodlit))
    yield Compared(_FLOODLIT, run.middle(relit), run.middle(floodlit), error)
    if run.has_truth:
        yield from _with_truth(run, floodlit)
    elif run.verified_images is not None:
        images = run.verified_images
        shown = range(min(_COLUMNS - 1, len(run.verified["pictures"])))
        relit, captured = (images.read(name) for name in ("relit", "captured"))
        for index in shown:
            facts = run.verified["pictures"][index]
            pair = run.middle(relit[index]), run.middle(captured[index])
            yield Compared(facts["name"], *pair, facts["error"])
    else:
        for name, image in zip(run.facts["names"], run.read("relit"), strict=True):
            yield Compared(words(name), run.middle(image))


def _with_truth(run: RelitAcquisition, floodlit: NDArray[Any]) -> Iterator[Compared]:
    """Yield the pictures under the reference patterns of a run whose truth is known."""
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


def _written_light(run: RelitAcquisition, pictures: Sequence[Compared]) -> dict[str, NDArray[Any]]:
    """Return the radiance of the pictures that are written as files.

    These are the floodlit image, a relit picture and its reference; without references, all relit
    pictures.
    """
    floodlit, *patterned = pictures
    if patterned and patterned[0].reference is None:
        names = [it.name.replace(" ", "_") for it in patterned]
        pairs = zip(names, patterned, strict=True)
        relit = {f"{name}_{run.method}": picture.relit for name, picture in pairs}
        return {_FLOODLIT: np.asarray(floodlit.reference), **relit}
    main = words(_MAIN_PICTURE)
    first = patterned[0] if patterned else floodlit
    shown = next((it for it in patterned if it.name == main), first)
    return {
        _FLOODLIT: np.asarray(floodlit.reference),
        "truth" if run.has_truth else "captured": np.asarray(shown.reference),
        f"relit_{run.method}": shown.relit,
    }


def _caption(inputs: ReportInputs, runs: Sequence[RelitAcquisition], white: float) -> str:
    patterns = ", ".join(
        f"{inputs.title(run.method).lower()} with {number(run.patterns)} patterns" for run in runs
    )
    first = runs[0]
    description = "The captured and the relit floodlit image, and further relit pictures"
    if first.has_truth:
        description = "True pictures, and below them relit ones, their errors and differences"
    elif first.verified_images is not None:
        description = "Captured verification pictures, relit ones, their errors and differences"
    brighter = ""
    if first.has_truth and first.is_coaxial and not first.settings.is_light_field:
        brighter = f" Pixels that a picture leaves dark are shown {UNLIT_GAIN} times brighter."
    return f"{description}: {patterns}. White is radiance {white:.3g}.{brighter}"
