"""The hard cases as a table: scene, method, patterns, error, what happened."""

from __future__ import annotations

from functools import partial
from typing import Any

from rfpipe.report import methods
from rfpipe.report.blocks import Section, Table, Tabulation, table_of
from rfpipe.report.inputs import Inputs, Study
from rfpipe.report.text import DASH, number, words

__all__ = ["hard_cases_section"]

_NUMERICAL = (
    "Small scenes that are hard to acquire, at the run's tolerance. Errors: relative Frobenius "
    "error of the whole matrix; the largest relative RMS error of a relit image; and the floodlit "
    "image summed in float32 by relighting against a sum in float64. The camera is the run's "
    "without its mosaic, its aperture set to the scene's brightness, except for the photon-starved "
    "scene. Misalignment by half a pixel breaks the symmetry that symmetric photography builds on; "
    "dual photography doesn't need it."
)
_FAULTS = (
    "Bad input, a rig that fails, and runs that are stopped or damaged, on scene IV at 16 x 16 "
    "pixels (files: 8 x 8); and the hard scenes by a method that hands over to another where light "
    "isn't smooth. Error: the largest relative RMS error of a relit image. Frames are "
    "spoilt one by one, or two of the camera's pixels in all; runs are stopped while the third "
    "level is captured. Stops in every other stage are left to the tests."
)


def hard_cases_section(inputs: Inputs, study: Study) -> Section:
    """Numerically hard scenes and, where that study was made, bad input and stopped runs."""
    blocks = [Tabulation("Hard cases", _NUMERICAL, _numerical_table(study))]
    sources = [study.source]
    faults = inputs.studies.get("faults")
    if faults is not None:
        table = _faults_table(faults)
        blocks.append(Tabulation("Bad input, failures, and handing over", _FAULTS, table))
        sources.append(faults.source)
    return Section("stability", "Hard cases", blocks, sources=sources)


def _numerical_table(study: Study) -> Table:
    scientific = partial(number, form=".1e")
    return table_of(
        [{**row, "happened": _happened(row)} for row in study.rows],
        [("case", "case", words), ("method", "method", methods.title), ("camera", "camera", str)],
        [
            ("patterns", "patterns", number),
            ("brute force", "rays", number),
            ("of T", "matrix_error", scientific),
            ("of an image", "relight_error", scientific),
            ("of float32 sums", "accumulation", scientific),
            ("what happened", "happened", str),
        ],
        [("", 5), ("relative error", 3), ("", 1)],
        csv="stability.csv",
    )


def _happened(row: dict[str, Any]) -> str:
    """Say what an acquisition came to."""
    if row["refused"]:
        return f"refused: {row['refused'].split(':', maxsplit=1)[0]}"
    if row["patterns"] > row["rays"]:
        return "acquired, with more patterns than brute force"
    return "acquired"


def _faults_table(study: Study) -> Table:
    return table_of(
        study.rows,
        [
            ("case", "case", words),
            ("scene", "scene", _or_dash),
            ("method", "method", lambda name: methods.title(name) if name else DASH),
            ("camera", "camera", _or_dash),
        ],
        [
            ("patterns", "patterns", number),
            ("brute force", "rays", number),
            ("error", "relight_error", partial(number, form=".1e")),
            ("what happened", "happened", str),
        ],
        csv="faults.csv",
    )


def _or_dash(text: str) -> str:
    return text or DASH
