"""What a collection's file holds, before anything is known of what it means."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rfpipe.config.own import OWN_TO_SCENES
from rfpipe.errors import ConfigError

__all__ = ["Path_", "Row", "refused", "target_of"]

_GROUPS = OWN_TO_SCENES - {"seed"}  # the scene's own seed is that of its texture

Path_ = tuple[str, ...]
"""A setting's name by its parts: ``camera.exposures`` is ``("camera", "exposures")``."""


@dataclass(frozen=True)
class Row:
    """One scene of a collection.

    Parameters
    ----------
    place : str
        Where it stands in its file, such as ``line 7``.
    values : dict
        By the settings' paths as they are written; texts, where `is_text`.
    places : dict of str
        Where each value stands, and what lies within it, by paths.
    is_text : bool
        Whether values are the texts of cells, which are still to be read as what they mean.
    comma : bool
        Whether a comma may stand for a decimal point, as where semicolons part cells.
    """

    place: str
    values: dict[Path_, object]
    places: dict[Path_, str]
    is_text: bool = False
    comma: bool = False


def target_of(path: Path_) -> Path_:
    """Return the setting of a scene that a path, as a column or key is called, stands for."""
    if path[0] in ("rig", "scene") and len(path) > 1:
        path = ("settings", *path[1:]) if path[0] == "rig" else path[1:]
    return ("settings", *path) if path[0] in _GROUPS else path


def refused(path: Path, problems: list[tuple[str, str]]) -> ConfigError:
    """Return the error that tells all that is wrong with a file, each with its place."""
    return ConfigError("\n".join(f"{path}: {place}: {what}" for place, what in problems))
