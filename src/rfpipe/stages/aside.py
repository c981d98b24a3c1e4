"""Captured stores that no longer fit the settings: kept aside, and found again."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, Literal

from rfpipe.errors import StaleStoreError
from rfpipe.store import FrameStore, StoreLock

__all__ = ["differing", "settle"]

_log = logging.getLogger(__name__)

_NAMED_DIGITS = 12
_SHOWN_DIFFERENCES = 6


def settle(
    path: Path,
    made_for: str,
    shown: dict[str, Any],
    when_changed: Literal["recapture", "refuse"],
) -> None:
    """Make way for the capture of `shown`: afterwards its store stands at `path`, or none does.

    A store of something else is renamed, its fingerprint in its new name. Back at the settings
    that it was made with, it is found again, so that the rig needn't be. If its pictures were
    dropped after their merge, it is removed.

    Parameters
    ----------
    path : Path
        The store's place.
    made_for : str
        Fingerprint of `shown`.
    shown : dict
        Plain data: what is about to be captured. A store has it as its attributes.
    when_changed : {"recapture", "refuse"}

    Raises
    ------
    StaleStoreError
        When a store of something else stands there, none fits, and `when_changed` is "refuse".
    LockedError
        When another process writes the store.
    """
    with StoreLock(path):
        fitting = _aside(path, made_for)
        if path.exists():
            with FrameStore.open(path) as old:
                if old.fingerprint == made_for:
                    return
                captured = int(old.done.sum())
                differences = differing(old.attributes, shown)
                place = _aside(path, old.fingerprint)
                is_dropped = old.dropped
            if captured and not fitting.exists():
                kept = None if is_dropped else place
                _say(path, kept, captured, differences, when_changed)
            if place.exists():  # of a settings' change that was undone before it was captured
                FrameStore.discard(place)
            path.rename(place)
            if is_dropped or not captured:
                FrameStore.discard(place)
        if fitting.exists():
            fitting.rename(path)
            _log.warning("%s: captured with these settings before; taken from %s", path, fitting)


def _aside(path: Path, fingerprint: str) -> Path:
    return path.with_name(f"{path.stem}.{fingerprint[:_NAMED_DIGITS]}{path.suffix}")


def _say(
    path: Path, place: Path | None, captured: int, differences: str, when_changed: str
) -> None:
    """Refuse to capture anew, or say that it is about to happen; `place` None: none are kept."""
    if when_changed == "refuse":
        old = "old ones are kept aside" if place else "old ones were dropped after their merge"
        raise StaleStoreError(
            f"{path}: holds {captured} captured patterns of other settings ({differences}); "
            "restore those settings, or set capture.when_patterns_change to recapture to take "
            f"these patterns anew (the {old})"
        )
    old = (
        f"captured with the old settings are kept in {place}, for when you go back to them; remove "
        "it to free the space"
        if place
        else "captured with the old settings were dropped after their merge (capture.keep_raw)"
    )
    _log.warning(
        "%s: CAPTURING ANEW, since the settings changed (%s). The %d patterns %s",
        path, differences, captured, old,
    )  # fmt: skip


def differing(old: dict[str, Any], new: dict[str, Any]) -> str:
    """Say which settings differ, such as ``patterns 64 -> 72, rig.seed 1 -> 2``."""
    before, after = _flat(old), _flat(new)
    changed = [
        f"{name} {before.get(name, 'unset')} -> {after.get(name, 'unset')}"
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    ]
    more = len(changed) - _SHOWN_DIFFERENCES
    return ", ".join(changed[:_SHOWN_DIFFERENCES]) + (f" and {more} more" if more > 0 else "")


def _flat(value: Any, name: str = "") -> dict[str, str]:
    """Name each setting by its place, such as ``rig.sensor.bits``."""
    if isinstance(value, list | tuple) and any(isinstance(item, dict) for item in value):
        value = {str(index): item for index, item in enumerate(value)}
    if isinstance(value, dict):
        parts = [_flat(item, f"{name}.{key}" if name else key) for key, item in value.items()]
        return {key: text for part in parts for key, text in part.items()}
    return {name: str(list(value) if isinstance(value, tuple) else value)}
