"""Checking a run's folder or a published one: every manifest, store and file, by its digest."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

from rfpipe.errors import InputError, StoreError
from rfpipe.storage.base import (
    CHECK_PICTURES,
    MORE_REFERENCE_BRACKETS,
    REFERENCE_BRACKETS,
    REFERENCE_IMAGES,
    SENSOR,
    STAGES,
    SUMS,
    SYMMETRY,
)
from rfpipe.storage.files import BY_PRODUCTS
from rfpipe.storage.repairs import RESTORE, Finding, Repair, is_acquisition, part_of, repair_of
from rfpipe.storage.run_record import RUN_RECORD
from rfpipe.store import (
    PictureStore,
    StoreLock,
    bytes_on_disk,
    header_is_whole,
    open_arrays,
    read_manifest,
)
from rfpipe.store.files import digest_of
from rfpipe.store.location import locate
from rfpipe.store.places import CHECKSUMS, METADATA, Place, as_address, content_of
from rfpipe.transport.storage import ZIP_NAME, transports_in

_TAGS = "tagmanifest-sha256.txt"
# Stores of a level that the manifest of another name is about.
_OWNERS = dict.fromkeys(
    (REFERENCE_BRACKETS, MORE_REFERENCE_BRACKETS, SYMMETRY, CHECK_PICTURES, SENSOR), "capture"
) | dict.fromkeys((SUMS, REFERENCE_IMAGES), "merge")
_STAGES_OF: dict[str, tuple[str, ...]] = {
    "acquisition": ("transport", "relight", "verification"),
    "level": STAGES,
    "verification": STAGES,
    "recording": ("matrix",),
}
_NAMED = 8  # files that a finding or a note names


@dataclass
class CheckResult:
    """Result of a check: damage, remarks and counts.

    Attributes
    ----------
    progress : callable
        Called with the number of bytes after each read.
    findings : list of Finding
        Damage, with the repair.
    notes : list of str
        Remarks that do not concern damage.
    stores, manifests, files, bytes : int
        Numbers of checked stores, manifests and files, and of bytes read.
    unnamed : list of Path
        Files that no manifest names, which are not checked.
    checked_paths : set of Path
        Stores, manifests and files that are checked.
    folders : set of Path
        Folders that were visited, without symbolic links.
    facts : dict of Path to dict
        Content of each undamaged manifest.
    """

    progress: Callable[[int], object] = lambda _: None
    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stores: int = 0
    manifests: int = 0
    files: int = 0
    bytes: int = 0
    unnamed: list[Path] = field(default_factory=list)
    checked_paths: set[Path] = field(default_factory=set)
    folders: set[Path] = field(default_factory=set)
    facts: dict[Path, dict[str, Any]] = field(default_factory=dict)

    def add_finding(self, path: Path | Place, what: str, mend: Repair) -> None:
        """Add a finding."""
        self.findings.append(Finding(path, what, mend))

    def read(self, nbytes: int) -> None:
        """Count bytes as read."""
        self.bytes += nbytes
        self.progress(nbytes)

    def removals(self) -> list[Path]:
        """Paths to remove before the workflow runs, without duplicates."""
        return list(
            dict.fromkeys(path for finding in self.findings for path in finding.repair.remove)
        )


def check(folder: Path, progress: Callable[[int], object] = lambda _: None) -> CheckResult:
    """Check every store, chunk, manifest and table below a folder.

    Parameters
    ----------
    folder : Path
        A run's (with ``results``), its results or one acquisition of them, a calibration, a store,
        or a published folder or zip with a list of its files; a zip file of a transport. Or the
        address of either.
    progress : callable, optional
        Called with the number of bytes after each read.

    Raises
    ------
    InputError
        When the folder has nothing to check.
    StoreError
        When a server doesn't answer.
    """
    checked = CheckResult(progress)
    place = folder if folder.is_dir() and as_address(folder) is None else locate(folder)
    if isinstance(place, Place) or (place / CHECKSUMS).is_file():
        _check_published(place, checked)
        return checked
    inside = [path for path in (folder / "results", folder / "calibration") if path.is_dir()]
    for root in inside if (folder / "results").is_dir() else [folder]:
        if root.is_dir():
            _check_below(root, checked)
    _note_unnamed(checked)
    if not checked.stores + checked.manifests and not checked.notes:
        raise InputError(
            f"{folder}: holds nothing of a run; expected results, one of its folders, a "
            "calibration, or a published folder or zip file"
        )
    return checked


def _check_published(place: Path | Place, checked: CheckResult) -> None:
    """Check files by their list, in one folder of a zip file, too; else transports."""
    if isinstance(place, Place) and not place.key and content_of(place / CHECKSUMS) is None:
        with suppress(StoreError):  # a web server doesn't list its files
            lists = [name for name in place.files() if name.endswith(f"/{CHECKSUMS}")]
            place = place / min(lists, key=len).removesuffix(f"/{CHECKSUMS}") if lists else place
    if content_of(place / CHECKSUMS) is not None:
        _check_list(place, checked)
        return
    is_store = content_of(place / METADATA) is not None
    stores = [place] if is_store else [place / name for name in transports_in(place)]
    if not stores:
        raise InputError(
            f"{place}: has no {CHECKSUMS} and no transport; expected what 'rfpipe keep' or 'rfpipe "
            "publish' made, or a transport"
        )
    for store in stores:
        if isinstance(store, Place) and store.key.endswith(ZIP_NAME):
            _check_published(locate(store), checked)
            continue
        for what in _check_arrays(store, checked).damage:
            checked.add_finding(store, what, RESTORE)


def _check_list(root: Path | Place, checked: CheckResult) -> None:
    """Check each file of a list ``digest  path``, as BagIt (RFC 8493) has it."""
    listed = {}
    for name in (CHECKSUMS, _TAGS):
        for line in (content_of(root / name) or b"").decode(errors="replace").splitlines():
            digest, _, path = line.strip().partition(" ")
            listed[unquote(path.lstrip(" \t*")).removeprefix("./")] = digest.lower()
    for name, digest in listed.items():
        checked.files += 1
        try:
            content = (root / name).read_bytes()
        except FileNotFoundError:
            checked.add_finding(root / name, "is missing", RESTORE)
        except (StoreError, OSError) as error:
            checked.add_finding(root / name, f"can't be read: {error}", RESTORE)
        else:
            checked.read(len(content))
            if hashlib.sha256(content).hexdigest() != digest:
                text = "is altered: its SHA-256 isn't that of the list"
                checked.add_finding(root / name, text, RESTORE)
    if isinstance(root, Place):
        with suppress(StoreError):  # a web server doesn't list its files
            _note_others(root, set(root.files()) - listed.keys(), checked)
    else:
        files = {path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file()}
        _note_others(root, files - listed.keys(), checked)


def _note_others(root: Path | Place, names: set[str], checked: CheckResult) -> None:
    payload = "" if content_of(root / "bagit.txt") is None else "data/"
    for name in sorted(names - {CHECKSUMS, _TAGS}):
        if name.startswith(payload):
            checked.notes.append(f"{root / name}: isn't in the list of files")


def _check_below(folder: Path, checked: CheckResult) -> None:
    """Check a folder and all below it, whatever their names, through symbolic links, too.

    Hidden ones are left out: they are temporary, or of other programs. No scene, method or stage
    has such a name.
    """
    if folder in checked.checked_paths or folder.resolve() in checked.folders:
        return
    checked.folders.add(folder.resolve())
    if folder.suffix == ".zarr":
        _check_alone(folder, checked)
        return
    is_whole = is_acquisition(folder)
    if is_whole and StoreLock.holder(folder) is not None:
        checked.notes.append(f"{folder}: is being acquired at this moment; not checked")
        return
    inside = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    files = [path for path in inside if path.is_file()]
    for path in filter(_is_manifest, files):
        _check_manifest(path, checked)
    for inner in inside:
        if inner.is_dir():
            _check_below(inner, checked)
        elif not inner.exists():
            checked.add_finding(
                inner, f"is a link to {inner.readlink()}, which is missing", RESTORE
            )
    checked.unnamed += files
    if is_whole:
        _check_acquisition(folder, checked)


def _is_manifest(path: Path) -> bool:
    """Test whether a file is a manifest, which may be damaged."""
    if path.suffix != ".json":
        return False
    is_about = path.name == RUN_RECORD or path.with_suffix(".zarr").exists()
    is_of_stage = path.stem in _STAGES_OF.get(part_of(path), ())
    return is_about or is_of_stage or b'"checksum"' in path.read_bytes()


def _note_unnamed(checked: CheckResult) -> None:
    """Note the files that were not checked, since no manifest names them: one line per folder."""
    checked.unnamed = sorted(
        path
        for path in checked.unnamed
        if path not in checked.checked_paths
        and not path.name.endswith(BY_PRODUCTS)
        and path.stat().st_size
    )
    for folder in dict.fromkeys(path.parent for path in checked.unnamed):
        names = [path.name for path in checked.unnamed if path.parent == folder]
        shown = ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")
        count = (
            "1 file that no manifest names is"
            if len(names) == 1
            else (f"{len(names)} files that no manifest names are")
        )
        checked.notes.append(f"{folder}: {count} not checked: {shown}")


def _check_manifest(path: Path, checked: CheckResult) -> None:
    """Check a manifest, and the stores and files that it names."""
    checked.manifests += 1
    checked.checked_paths.add(path)
    try:
        facts = checked.facts[path] = read_manifest(path)
    except StoreError as error:  # its stores are checked alone
        checked.add_finding(path, _damage_of(error, path), repair_of(path))
        return
    for store, digest in _stores_of(path, facts):
        damage, stored, _ = _check_store(store, checked)
        if digest is not None and stored not in (None, digest):
            damage.append(f"isn't the store of {path.name}: its digest is {stored}, not {digest}")
        is_patterns = store.stem == path.stem and facts.get("stage") == "schedule"
        if is_patterns and not damage and open_arrays(store).attributes["facts"] != facts:
            damage.append(f"holds other patterns than {path.name} says")
        for what in damage:
            checked.add_finding(store, what, repair_of(path, store))
    for name, digest in facts.get("files", {}).items():
        _check_file(path, path.parent / name, digest, checked)


def _stores_of(path: Path, facts: dict[str, Any]) -> Iterator[tuple[Path, str | None]]:
    """Yield the stores that a manifest names, each with its digest, None where it states none."""
    for kind, first, _ in facts.get("pieces", ()):  # of recorded light
        yield path.with_name(f"{kind}_{first:08d}.zarr"), None
    for name, entry in {path.stem: facts, **{key: facts.get(key) for key in _OWNERS}}.items():
        store = path.with_name(f"{name}.zarr")
        # a calibration calls the digest of its store arrays
        stated = isinstance(entry, dict) and (entry.get("digest") or entry.get("arrays"))
        if stated:
            yield store, str(stated)
        elif name == path.stem and (store.exists() or facts.get("stage") == "schedule"):
            yield store, None


def _check_file(manifest: Path, file: Path, digest: str, checked: CheckResult) -> None:
    """Check a file that a manifest names with its digest."""
    checked.checked_paths.add(file)
    checked.files += 1
    content = content_of(file)
    checked.read(len(content or b""))
    if content is None:
        checked.add_finding(file, "is missing", repair_of(manifest, file))
    elif digest_of(content) != digest:
        what = f"is altered: its digest isn't that of {manifest.name}"
        checked.add_finding(file, what, repair_of(manifest, file))


def _check_alone(path: Path, checked: CheckResult) -> None:
    """Check a store that no whole manifest names: one kept aside, a recording, a user's own."""
    manifest = path.with_name(f"{_OWNERS.get(path.stem, path.stem)}.json")
    is_recording = part_of(path) == "recording"
    state = _check_store(path, checked)
    for what in state.damage:
        if state.interrupted:
            checked.notes.append(f"{path}: {what}")
        elif is_recording:
            checked.add_finding(path, what, repair_of(path))
        else:
            checked.add_finding(
                path, what, repair_of(manifest, path) if manifest.exists() else RESTORE
            )


class _StoreState(NamedTuple):
    """Result of the check of a store: its damage, and its digest where that is known.

    `interrupted` is True for frames whose capture hasn't ended.
    """

    damage: list[str]
    digest: str | None
    interrupted: bool = False


def _check_store(path: Path, checked: CheckResult) -> _StoreState:
    """Check a store of frames or of arrays."""
    checked.checked_paths.add(path)
    header = content_of(path / METADATA) or b""
    if (path / "journal.jsonl").exists() or re.search(rb'"kind":\s*"frames"', header):
        return _check_frames(path, checked)
    return _check_arrays(path, checked)


def _check_arrays(path: Path | Place, checked: CheckResult) -> _StoreState:
    checked.stores += 1
    damage: list[str] = []
    try:
        bundle = open_arrays(path)
    except StoreError as error:
        return _StoreState([_damage_of(error, path)], None)
    if isinstance(path, Path):
        named = {path / name for name in (METADATA, *bundle.names)}
        entries = [entry for entry in path.iterdir() if not entry.name.startswith(".")]
        checked.unnamed += [entry for entry in entries if entry not in named]
    for name in bundle.names:
        try:
            checked.read(bundle.read(name).nbytes)
        except StoreError as error:
            damage.append(_damage_of(error, path))
    return _StoreState(damage, bundle.digest)


def _check_frames(path: Path, checked: CheckResult) -> _StoreState:
    checked.stores += 1
    if not header_is_whole(path):
        damage = f"its header, {METADATA} or its copy header.json, is damaged or missing"
        return _StoreState([damage], None)
    try:
        store = PictureStore.open(path)
        if not store.complete:
            absent = store.shape[0] - int(store.done.sum())
            damage = f"{absent} of {store.shape[0]} items are not in its journal"
            return _StoreState([damage], None, interrupted=True)
        altered = [] if store.dropped else store.damaged()
    except StoreError as error:
        return _StoreState([_damage_of(error, path)], None)
    checked.read(bytes_on_disk(path))
    if not altered:
        return _StoreState([], store.digest())
    files = ", ".join(sorted({file.name for file in store.files_of(altered)})[:_NAMED])
    which = f"{len(altered)} of {store.shape[0]} items are missing, truncated or altered"
    return _StoreState([f"{which} ({files})"], store.digest())


def _damage_of(error: StoreError, path: Path | Place) -> str:
    """Describe damage without the store's path and the remedy, which the finding states."""
    if error.place in (None, path):
        return error.what
    return f"{str(error.place).removeprefix(f'{path}/')}: {error.what}"


def _check_acquisition(folder: Path, checked: CheckResult) -> None:
    """Check that a transport was made of its levels, and its relit pictures of the transport."""
    transport = folder / "transport.json"
    if not transport.exists():
        _check_unfinished(folder, checked)
    made = checked.facts.get(transport)
    if made is None:
        return
    for number, digest in made.get("inputs", {}).get("refine", ()):
        level = folder / f"L{number:02d}"
        for manifest in (level / f"{stage}.json" for stage in STAGES):
            if not manifest.exists():
                checked.add_finding(manifest, "is missing", repair_of(manifest))
        refined = checked.facts.get(level / "refine.json")
        if refined and refined["digest"] != digest:
            text = f"was made of another version of {level.name}/refine.json"
            checked.add_finding(transport, text, repair_of(transport))
    for path, facts in checked.facts.items():
        if path.parent == folder and facts.get("transport", made["digest"]) != made["digest"]:
            checked.add_finding(
                path, "was made of another transport than transport.json", repair_of(path)
            )


def _check_unfinished(folder: Path, checked: CheckResult) -> None:
    """Check that nothing is made of the transport of an acquisition that has none."""
    transport = folder / "transport.json"
    later = [path for path, of in checked.facts.items() if path.parent == folder and
             "transport" in of]  # fmt: skip
    if later:
        names = " and ".join(path.name for path in later)
        checked.add_finding(transport, f"is missing, and {names} is made of it", Repair("run"))
    else:
        checked.notes.append(f"{folder}: not finished; the next run continues it")
