"""Brackets of other settings, which are set aside before a capture instead of being deleted."""

from __future__ import annotations

import logging
from pathlib import Path

from rfpipe.errors import StaleStoreError
from rfpipe.storage.base import Attributes, WhenChanged
from rfpipe.storage.differences import differing
from rfpipe.store import PictureStore

_FINGERPRINT_DIGITS = 12  # in the name of a store that is set aside

_log = logging.getLogger(__name__)


def set_aside(
    path: Path,
    old: PictureStore,
    fingerprint: str,
    attributes: Attributes,
    when_changed: WhenChanged,
) -> None:
    """Rename a store of another fingerprint; remove it if it has no brackets.

    `fingerprint` and `attributes` are for the brackets to be captured.
    """
    captured = int(old.done.sum())
    place = name_aside(path, old.fingerprint)
    if captured and not name_aside(path, fingerprint).exists():
        _refuse_or_warn(path, old, place, attributes, when_changed)
    PictureStore.discard(place)  # of a change that was undone before it was captured
    path.rename(place)
    if old.dropped or not captured:
        PictureStore.discard(place)


def name_aside(path: Path, fingerprint: str) -> Path:
    """Return the path of a store of this fingerprint that is set aside."""
    return path.with_name(f"{path.stem}.{fingerprint[:_FINGERPRINT_DIGITS]}{path.suffix}")


def _refuse_or_warn(
    path: Path, old: PictureStore, place: Path, attributes: Attributes, when_changed: WhenChanged
) -> None:
    """Refuse to capture patterns again whose settings changed, or warn of it."""
    changed, captured = differing(old.attributes, attributes), int(old.done.sum())
    fate = (
        "were dropped after their merge (capture.keep_raw)"
        if old.dropped
        else f"are kept in {place}, for when you go back to them; remove it to free the space"
    )
    if when_changed == "refuse":
        raise StaleStoreError(
            f"{path}: holds {captured} captured patterns of other settings ({changed})",
            remedy="restore those settings, or set capture.when_patterns_change to recapture to "
            f"take these patterns again (the old ones {fate})",
        )
    _log.warning(
        "%s: CAPTURING AGAIN, since the settings changed (%s). The %d patterns captured with "
        "the old settings %s", path, changed, captured, fate,
    )  # fmt: skip
