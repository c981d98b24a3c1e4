"""Stage: studies for the report that stand beside the acquisitions of the configured scenes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint
from rfpipe.stages.results import write_bundle
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["FIGURES", "STUDIES", "run", "run_study"]

STUDIES = ("resolution", "stability", "mosaic")
"""Patterns against resolution [Fig. 3.8], numerically hard cases, colour normalization under a
Bayer mosaic [Fig. B.1]."""

FIGURES = {
    "walk": "dual_pictures",
    "box": "dual_pictures",
    "bottle": "dual_pictures",
    "samples": "dual_pictures",
    "right_angles": "dual_pictures",
    "growth": "growth",
    "arc": "arc",
    "bears": "symmetric_pictures",
    "flare": "symmetric_pictures",
    "views": "views",
    "laws": "laws",
    "faults": "faults",
}
"""The studies behind the thesis' other figures, most on physically based scenes, and what bad input
leads to; with their modules here. Made where ``report.figures`` is set."""


def run_study(name: str, config: Config) -> tuple[list[dict[str, Any]], dict[str, NDArray[Any]]]:
    """Run one of `STUDIES` or `FIGURES`; return its table's rows as plain data, and its images.

    Raises
    ------
    InputError
        If there is no such study.
    """
    if name in FIGURES:
        module = import_module(f"{__name__}.{FIGURES[name]}")
        made: tuple[list[dict[str, Any]], dict[str, NDArray[Any]]] = getattr(
            module, f"{name}_study"
        )(config)
        return made
    if name not in STUDIES:
        raise InputError(f"study {name!r}: expected one of {', '.join((*STUDIES, *FIGURES))}")
    from rfpipe.stages.evaluating.studies import mosaic, resolution, stability

    of_name = {
        "resolution": resolution.resolution_study,
        "stability": stability.stability_study,
        "mosaic": mosaic.mosaic_study,
    }
    return of_name[name](config)


def run(name: str, config: Config, manifest: Path, code: str) -> None:
    """Run a study; write its images and a manifest that holds its table.

    Parameters
    ----------
    name : str
        One of `STUDIES` or `FIGURES`.
    config : Config
    manifest : Path
        The store of images stands beside it; empty for a study without images.
    code : str
        Digest of the code behind the stage.
    """
    made_from = fingerprint({"study": name, "config": config, "code": code})
    rows, arrays = run_study(name, config)
    rows = [{key: _plain(value) for key, value in row.items()} for row in rows]
    facts = {"stage": "study", "study": name, "rows": rows, "units": RADIANCE_UNIT}
    write_bundle(manifest, made_from, arrays, facts)


def _plain(value: Any) -> Any:
    """Return a value that JSON can hold; NaN and infinity become None."""
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
