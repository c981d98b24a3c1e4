"""Checking a store: its header, its journal and every chunk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rfpipe.errors import IntegrityError, StoreError
from rfpipe.provenance import fingerprint
from rfpipe.stages.verifying.findings import Checked
from rfpipe.store import FrameStore, bytes_on_disk, header_is_whole, open_arrays
from rfpipe.store.places import METADATA, Place

__all__ = ["check_bundle", "check_frames", "check_store", "first_sentence", "made_for"]

_NAMED = 8


def check_store(path: Path, checked: Checked) -> tuple[list[str], str | None]:
    """Check a store of either kind; return what is wrong with it, and its digest if known."""
    is_frames = (path / "journal.jsonl").exists() or b'"frames"' in _header(path)
    return (check_frames if is_frames else check_bundle)(path, checked)


def check_bundle(path: Path, checked: Checked) -> tuple[list[str], str | None]:
    """Check a bundle of arrays, every chunk; return what is wrong, and the digest it states.

    Parameters
    ----------
    path : Path
    checked : Checked
        Counts it.
    """
    checked.stores += 1
    checked.seen.add(path)
    if not path.is_dir():
        return ["is missing"], None
    wrong = []
    digest = None
    try:
        bundle = open_arrays(path)
        digest = bundle.digest
        for name in bundle.names:
            try:
                bundle.read(name)
            except IntegrityError as error:
                wrong.append(first_sentence(error, path))
        strange = {part.name for part in path.iterdir()} - {METADATA, *bundle.names}
        if strange:
            wrong.append(f"holds {', '.join(sorted(strange))}, which is no part of it")
    except StoreError as error:
        wrong.append(first_sentence(error, path))
    checked.read(bytes_on_disk(path))
    return wrong, digest


def check_frames(path: Path, checked: Checked) -> tuple[list[str], str | None]:
    """Check a store of frames, every item; return what is wrong, and its digest if complete.

    Of one whose items were dropped on purpose, header and journal are checked.
    """
    checked.stores += 1
    checked.seen.add(path)
    if not path.is_dir():
        return ["is missing"], None
    wrong = []
    digest = None
    if not header_is_whole(path):
        wrong.append(f"its header, {METADATA} or its copy header.json, is damaged or missing")
    try:
        store = FrameStore.open(path)
        if store.complete:
            digest = store.digest()
        else:
            absent = [int(item) for item in (~store.done).nonzero()[0]]
            wrong.append(f"{_items(absent, store.shape[0])} not in its journal")
        if not store.dropped:
            damaged = store.damaged()
            if damaged:
                files = sorted({file.name for file in store.files_of(damaged)})
                which = _items(damaged, store.shape[0])
                named = ", ".join(files[:_NAMED])
                wrong.append(f"{which} missing, truncated or altered ({named})")
    except StoreError as error:
        wrong.append(first_sentence(error, path))
    checked.read(bytes_on_disk(path))
    return wrong, digest


def made_for(path: Path, stated: str | None) -> list[str]:
    """Say where a store of frames was made for other settings than stated.

    The attributes of captured frames are all that was shown, and their fingerprint tells of it.
    """
    try:
        store = FrameStore.open(path)
    except StoreError:
        return []  # which is found elsewhere
    if stated not in (None, store.fingerprint):
        return ["its header is damaged, or it was made for other settings than its manifest says"]
    if "rig" in store.attributes and fingerprint(store.attributes) != store.fingerprint:
        return ["its header is damaged: its attributes aren't those of its fingerprint"]
    return []


def _items(items: list[int], count: int) -> str:
    named = ", ".join(map(str, items[:_NAMED])) + (", ..." if len(items) > _NAMED else "")
    return f"{len(items)} of {count} items are" if len(items) > 1 else f"item {named} of {count} is"


def first_sentence(error: Exception, path: Path | Place) -> str:
    """Return what an error says is wrong, without the place and without advice."""
    text = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}/")
    for advice in (". Remove", ". Fetch", "; remove", "; restore", "; run", ". Run", ". To do so"):
        text = text.partition(advice)[0]
    return text


def _header(path: Path) -> bytes:
    header: Any = path / METADATA
    return header.read_bytes()[:4096] if header.is_file() else b""
