"""What a check finds; the check of one store, and of files against a list of their SHA-256."""

from __future__ import annotations

import hashlib
import lzma
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import IO, Any, Literal, NamedTuple
from urllib.parse import unquote

from rfpipe.errors import InputError, IntegrityError, StoreError
from rfpipe.provenance import fingerprint
from rfpipe.store import FrameStore, bytes_on_disk, header_is_whole, open_arrays
from rfpipe.store.places import METADATA, Place, content_of, locate
from rfpipe.transport.storage import ZIP_NAME, transports_in

LIST = "manifest-sha256.txt"
"""A line a file: 64 hexadecimal digits, spaces, its path; as BagIt (RFC 8493) has it."""

_TAGS = "tagmanifest-sha256.txt"
_LINE = re.compile(r"\s*([0-9a-fA-F]{64})[ \t]+[*]?(.+?)\s*")
_BLOCK = 2**20
_NAMED = 8  # items and files that a finding names
# What `zipfile` raises on damaged bytes.
_DAMAGE = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, OSError, ValueError)


class Mend(NamedTuple):
    """What mends a finding: the workflow, `rfpipe calibrate`, or a copy alone.

    Attributes
    ----------
    remove : tuple of Path
        Removed first, so that the workflow notices that something is missing.
    cost : str
        What it takes, where that is more than some computing.
    """

    how: Literal["run", "calibrate", "restore"]
    remove: tuple[Path, ...] = ()
    cost: str = ""


RESTORE = Mend("restore")


class Finding(NamedTuple):
    """A store, manifest or file that is damaged: its path, the damage, and what mends it."""

    path: Path | Place
    what: str
    mend: Mend


@dataclass
class Checked:
    """What was checked, and the damage.

    Attributes
    ----------
    notes : list of str
        Remarks on what is no damage.
    stores, manifests, files, bytes : int
        Counts of what was checked, and the bytes read, of which `progress` is told.
    seen : set of Path
        Stores that are checked.
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


def check_arrays(path: Path | Place, checked: Checked) -> tuple[list[str], str | None]:
    """Check every array of a bundle; return the damage, and the bundle's digest if it is known."""
    checked.stores += 1
    damage: list[str] = []
    try:
        bundle = open_arrays(path)
    except StoreError as error:
        return [damage_of(error, path)], None
    for name in bundle.names:
        try:
            checked.read(bundle.read(name).nbytes)
        except StoreError as error:
            damage.append(damage_of(error, path))
    if isinstance(path, Path):
        strange = {part.name for part in path.iterdir()} - {METADATA, *bundle.names}
        if strange:
            damage.append(f"holds {', '.join(sorted(strange))}, which is no part of it")
    return damage, bundle.digest


def _check_frames(path: Path, checked: Checked, stated: str | None) -> tuple[list[str], str | None]:
    """Check every item of a store of frames, of a fingerprint that its manifest may state."""
    checked.stores += 1
    damage, digest = [], None
    if not header_is_whole(path):
        damage.append(f"its header, {METADATA} or its copy header.json, is damaged or missing")
    try:
        store = FrameStore.open(path)
        if store.complete:
            digest = store.digest()
        else:
            absent = [int(item) for item in (~store.done).nonzero()[0]]
            damage.append(f"{_items(absent, store.shape[0])} not in its journal")
        altered = [] if store.dropped else store.damaged()
    except StoreError as error:
        return [*damage, damage_of(error, path)], None
    checked.read(bytes_on_disk(path))
    if altered:
        files = sorted({file.name for file in store.files_of(altered)})[:_NAMED]
        which = _items(altered, store.shape[0])
        damage.append(f"{which} missing, truncated or altered ({', '.join(files)})")
    # the attributes of captured frames are all that was shown
    told = fingerprint(store.attributes) if "rig" in store.attributes else store.fingerprint
    if not damage and {told, stated or told} != {store.fingerprint}:
        damage.append("its header is damaged, or it was made for other settings than its manifest")
    return damage, digest


def check_store(
    path: Path, checked: Checked, stated: str | None = None
) -> tuple[list[str], str | None]:
    """Check a store of frames or of arrays; return the damage, and its digest if it is known."""
    checked.seen.add(path)
    if not path.is_dir():
        checked.stores += 1
        return ["is missing"], None
    header = path / METADATA
    is_frames = (path / "journal.jsonl").exists() or (
        header.is_file() and re.search(rb'"kind":\s*"frames"', header.read_bytes())
    )
    return _check_frames(path, checked, stated) if is_frames else check_arrays(path, checked)


def _items(items: list[int], count: int) -> str:
    named = ", ".join(map(str, items[:_NAMED])) + (", ..." if len(items) > _NAMED else "")
    return f"{len(items)} of {count} items are" if len(items) > 1 else f"item {named} of {count} is"


def damage_of(error: Exception, path: Path | Place) -> str:
    """Return an error's message without the place that a finding names."""
    return str(error).removeprefix(f"{path}: ").removeprefix(f"{path}/")


def check_place(place: Path | Place, checked: Checked) -> bool:
    """Check a folder with a list of its files; of a `Place`, a transport or transports, too.

    False for a folder on the disk without a list. Raises InputError when a zip file or an address
    has neither, StoreError when a server doesn't answer.
    """
    root, names = _files(place)
    listed = content_of(root / LIST)
    if listed is not None:
        # a web server doesn't list its files: then those count that the list names
        _check_list(root, names or {LIST, *_lines(listed)[0]}, checked)
        return True
    if isinstance(place, Path):
        return False
    is_store = content_of(place / METADATA) is not None
    stores = [place] if is_store else [place / name for name in transports_in(place)]
    if not stores:
        raise InputError(
            f"{place}: has no {LIST} and no transport; expected what 'rfpipe keep' or 'rfpipe "
            "publish' made, or a transport"
        )
    for store in stores:
        if isinstance(store, Place) and store.key.endswith(ZIP_NAME):
            check_place(locate(store), checked)
            continue
        for what in check_arrays(store, checked)[0]:
            checked.wrong(store, what, RESTORE)
    return True


def _files(place: Path | Place) -> tuple[Path | Place, set[str]]:
    """Return the folder that has a list, the place or one folder in a zip, and its files."""
    if isinstance(place, Path):
        is_listed = (place / LIST).is_file()
        files = (file for file in place.rglob("*") if file.is_file()) if is_listed else ()
        return place, {file.relative_to(place).as_posix() for file in files}
    try:
        names = set(place.files())
    except StoreError:
        return place, set()
    lists = [name for name in names if PurePosixPath(name).name == LIST]
    folder = min(lists, key=lambda name: name.count("/"), default="").removesuffix(LIST)
    if place.key or not folder:
        return place, names
    inside = {name.removeprefix(folder) for name in names if name.startswith(folder)}
    return place / folder, inside


def _lines(content: bytes) -> tuple[dict[str, str], list[int]]:
    """Return the digests of a list by path, and the numbers of the lines that are none."""
    digests, strange = {}, []
    for number, line in enumerate(content.decode("utf-8-sig", "replace").splitlines(), 1):
        if entry := _LINE.fullmatch(line):
            digests[unquote(entry[2]).removeprefix("./")] = entry[1].lower()
        elif line.strip():
            strange.append(number)
    return digests, strange


def _check_list(root: Path | Place, names: set[str], checked: Checked) -> None:
    """Check each file of the list, and note which files it lacks.

    In a bag the payload lies in ``data``; a plain list names all files.
    """
    listed: dict[str, str] = {}
    for name in {LIST, _TAGS} & names:
        digests, strange = _lines((root / name).read_bytes())
        listed |= digests
        for number in strange:
            checked.wrong(root / name, f"line {number} is no SHA-256 and path", RESTORE)
    for name, digest in listed.items():
        path = root / name
        checked.files += 1
        try:
            if name not in names:
                raise FileNotFoundError
            with path.open() if isinstance(path, Place) else path.open("rb") as file:
                if _sha256(file, checked) != digest:
                    checked.wrong(path, "is altered: its SHA-256 isn't that of the list", RESTORE)
        except FileNotFoundError:
            checked.wrong(path, "is missing", RESTORE)
        except (IntegrityError, *_DAMAGE) as error:
            checked.wrong(path, f"can't be read: {error}", RESTORE)
    is_bag = "bagit.txt" in names
    for name in sorted(names - listed.keys() - {LIST, _TAGS}):
        if not is_bag or name.startswith("data/"):
            checked.notes.append(f"{root / name}: isn't in the list of files")


def _sha256(file: IO[bytes], checked: Checked) -> str:
    digest = hashlib.sha256()
    while block := file.read(_BLOCK):
        digest.update(block)
        checked.read(len(block))
    return digest.hexdigest()
