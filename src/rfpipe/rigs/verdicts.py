"""What a rig's calibration found of it, and whether it is to be used."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from rfpipe.errors import ConfigError

__all__ = ["STANDINGS", "VERDICTS_KEY", "check_verdicts", "faults_of", "verdicts_of", "warn_of"]

VERDICTS_KEY = "calibration"
"""Where a rig's description tells of its calibration."""

STANDINGS = {
    "good": "good",
    "poor": "NOT GOOD",
    "unknown": "can't tell",
    "failed": "NOT MEASURED",
}
"""How verdicts read, by their standing."""

_log = logging.getLogger(__name__)


def verdicts_of(facts: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """Return the verdicts of a calibration's facts: title, standing and verdict of each step."""
    names = "title", "standing", "verdict"
    return {step: {name: str(of_step[name]) for name in names} for step, of_step in facts.items()}


def faults_of(verdicts: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Say of each step that isn't good what it found."""
    return [
        f"{one['title']}: {STANDINGS[one['standing']]}. {one['verdict']}"
        for one in verdicts.values()
        if one["standing"] in ("poor", "failed")
    ]


def check_verdicts(facts: Mapping[str, Any], folder: str | None, *, force: bool) -> None:
    """Refuse a rig whose calibration found faults, or warn of them where that is forced.

    Parameters
    ----------
    facts : mapping
        Those of a `Calibration`; empty where the rig has none.
    folder : str or None
        Where it lies; None for a rig without one.
    force : bool

    Raises
    ------
    ConfigError
        When a step is not good, and it isn't forced: names each, and what to do.
    """
    if folder is None:
        _log.warning(
            "the rig has no calibration: nothing is known of its noise, its response and its rays. "
            "Make one with `rfpipe calibrate`, and name its folder in the setting calibration"
        )
        return
    faults = faults_of(verdicts_of(facts))
    if faults and not force:
        told = "\n".join(f"  {fault}" for fault in faults)
        raise ConfigError(
            f"{folder}: the calibration is not good, so that pictures of this rig can't be relied "
            f"on:\n{told}\nSee {folder}/report.html; mend it, and run `rfpipe calibrate` again. To "
            "go on all the same, add --force: the reports will say so"
        )
    for fault in faults:
        _log.warning("%s: %s", folder, fault)


def warn_of(described: Mapping[str, Any], name: str) -> None:
    """Warn of what the calibration of a rig found, by the rig's description."""
    for fault in faults_of(described.get(VERDICTS_KEY) or {}):
        _log.warning("%s: its calibration is not good. %s", name, fault)
