"""What a check finds, and the check of one store: its header, its journal and every chunk."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from rfpipe.errors import StoreError
from rfpipe.provenance import fingerprint
from rfpipe.store import FrameStore, bytes_on_disk, header_is_whole, open_arrays
from rfpipe.store.places import METADATA, Place

_NAMED = 8  # items and files that a finding names


@dataclass(frozen=True)
class Mend:
    """What mends a finding.

    Attributes
    ----------
    how : {"run", "calibrate", "restore"}
        By the workflow, by `rfpipe calibrate`, or from a copy: nothing here makes it anew.
    remove : tuple of Path
        Removed first, so that the workflow notices that something is missing.
    cost : str
        What it takes, where that is more than some computing.
    """

    how: Literal["run", "calibrate", "restore"]
    remove: tuple[Path, ...] = ()
    cost: str = ""


RESTORE = Mend("restore")


@dataclass(frozen=True)
class Finding:
    """A store, manifest or file that is damaged: its path, the damage, and what mends it."""

    path: Path | Place
    what: str
    mend: Mend


@dataclass
class Checked:
    """What was checked, and the damage.

    Attributes
    ----------
    findings : list of Finding
    notes : list of str
        Remarks on what is no damage.
    stores, manifests, files, bytes : int
        Counts of what was checked, and the bytes read.
    progress : callable
        Called with the number of bytes of each read.
    seen : set of Path
        Stores and manifests that are checked.
    facts : dict of Path to dict
        The content of each whole manifest.
    """

    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stores: int = 0
    manifests: int = 0
    files: int = 0
    bytes: int = 0
    progress: Callable[[int], object] = lambda _: None
    seen: set[Path] = field(default_factory=set)
    facts: dict[Path, dict[str, Any]] = field(default_factory=dict)

    def wrong(self, path: Path | Place, what: str, mend: Mend) -> None:
        """Add a finding."""
        self.findings.append(Finding(path, what, mend))

    def read(self, nbytes: int) -> None:
        """Count bytes as read."""
        self.bytes += nbytes
        self.progress(nbytes)

    def removals(self) -> list[Path]:
        """Return all that has to go before the workflow runs, each once."""
        return list(dict.fromkeys(path for each in self.findings for path in each.mend.remove))


_FRAMES = re.compile(rb'"kind":\s*"frames"')


def check_store(
    path: Path, checked: Checked, stated: str | None = None
) -> tuple[list[str], str | None]:
    """Check every item of a store of frames, or every array of a bundle.

    Parameters
    ----------
    path : Path
    checked : Checked
        Counts it.
    stated : str, optional
        The fingerprint that the manifest states of frames.

    Returns
    -------
    damage : list of str
    digest : str or None
        That of the whole store, if it is known.
    """
    checked.stores += 1
    checked.seen.add(path)
    if not path.is_dir():
        return ["is missing"], None
    header = path / METADATA
    is_frames = (path / "journal.jsonl").exists() or (
        header.is_file() and _FRAMES.search(header.read_bytes()) is not None
    )
    damage: list[str] = []
    try:
        digest = (
            _check_frames(path, damage, stated) if is_frames else _check_arrays(path, damage)[0]
        )
    except StoreError as error:
        damage.append(first_sentence(error, path))
        digest = None
    checked.read(bytes_on_disk(path))
    return damage, digest


def _check_arrays(path: Path | Place, damage: list[str]) -> tuple[str, int]:
    """Return the digest of the bundle, and the bytes of its whole arrays."""
    bundle, nbytes = open_arrays(path), 0
    for name in bundle.names:
        try:
            nbytes += bundle.read(name).nbytes
        except StoreError as error:
            damage.append(first_sentence(error, path))
    if isinstance(path, Path):
        strange = {part.name for part in path.iterdir()} - {METADATA, *bundle.names}
        if strange:
            damage.append(f"holds {', '.join(sorted(strange))}, which is no part of it")
    return bundle.digest, nbytes


def _check_frames(path: Path, damage: list[str], stated: str | None) -> str | None:
    if not header_is_whole(path):
        damage.append(f"its header, {METADATA} or its copy header.json, is damaged or missing")
    store, digest = FrameStore.open(path), None
    if store.complete:
        digest = store.digest()
    else:
        absent = [int(item) for item in (~store.done).nonzero()[0]]
        damage.append(f"{_items(absent, store.shape[0])} not in its journal")
    altered = [] if store.dropped else store.damaged()
    if altered:
        files = sorted({file.name for file in store.files_of(altered)})[:_NAMED]
        which = _items(altered, store.shape[0])
        damage.append(f"{which} missing, truncated or altered ({', '.join(files)})")
    if not damage and stated not in (None, store.fingerprint):
        damage.append("its header is damaged, or it was made for other settings than its manifest")
    # the attributes of captured frames are all that was shown
    told = fingerprint(store.attributes) if "rig" in store.attributes else store.fingerprint
    if not damage and told != store.fingerprint:
        damage.append("its header is damaged: its attributes aren't those of its fingerprint")
    return digest


def check_arrays_afar(place: Place, checked: Checked) -> None:
    """Check a bundle of arrays in a zip file or behind an address."""
    checked.stores += 1
    damage: list[str] = []
    try:
        checked.read(_check_arrays(place, damage)[1])
    except StoreError as error:
        damage.append(first_sentence(error, place))
    for what in damage:
        checked.wrong(place, what, RESTORE)


def _items(items: list[int], count: int) -> str:
    named = ", ".join(map(str, items[:_NAMED])) + (", ..." if len(items) > _NAMED else "")
    return f"{len(items)} of {count} items are" if len(items) > 1 else f"item {named} of {count} is"


def first_sentence(error: Exception, path: Path | Place) -> str:
    """Return the damage that an error tells, without the place and without advice."""
    text = str(error).removeprefix(f"{path}: ").removeprefix(f"{path}/")
    for advice in (". Remove", ". Fetch", "; remove", "; restore", "; run", ". Run", ". To do so"):
        text = text.partition(advice)[0]
    return text
