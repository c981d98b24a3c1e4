"""Checking a run's folder: every manifest, the stores it is about, and what they say of others."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, StoreError
from rfpipe.keys import VERIFICATION_KEY
from rfpipe.stages.capture import SENSOR
from rfpipe.stages.checking.again import RUN, run_again, shell_path
from rfpipe.stages.checking.published import check_place
from rfpipe.stages.checking.stores import RESTORE, Checked, Finding, Mend, check_store
from rfpipe.stages.checking.stores import first_sentence as damage_of
from rfpipe.stages.folder import REFERENCE, SYMMETRY, with_followers
from rfpipe.stages.merge import SUMS
from rfpipe.stages.merger import REFERENCES
from rfpipe.stages.results import FILES
from rfpipe.stages.verification import MANIFEST as VERIFICATION
from rfpipe.stages.watch import DRIFT, MOVES
from rfpipe.store import StoreLock, open_arrays, read_manifest
from rfpipe.store.files import digest_of
from rfpipe.store.places import as_address, locate

_STAGES = ("schedule", "capture", "merge", "normalize", "refine")
# Stores of a level that the manifest of another name is about.
_OWNERS = dict.fromkeys((REFERENCE, SYMMETRY, DRIFT, MOVES, SENSOR), "capture") | dict.fromkeys(
    (SUMS, REFERENCES), "merge"
)
_LEFT_OUT = (".snakemake", ".git", ".venv", "bench")
_LEVEL = re.compile(r"L(\d\d+)")


def check(folder: Path, progress: Callable[[int], object] | None = None) -> Checked:
    """Check every store, chunk, manifest and table below a folder.

    Parameters
    ----------
    folder : Path
        A run's (with ``results``), its results or one acquisition of them, a calibration, a store,
        or a published folder or zip with a list of its files; a zip file of a transport. Or the
        address of either.
    progress : callable, optional
        Called with the number of bytes that were read, as they are.

    Raises
    ------
    InputError
        When there is no such folder, or nothing in it that could be checked.
    StoreError
        When a server doesn't answer.
    """
    checked = Checked(progress=progress or (lambda _: None))
    place = folder if folder.is_dir() and as_address(folder) is None else locate(folder)
    if isinstance(place, Path) and not place.is_dir():
        raise InputError(
            f"{folder}: is no folder and no zip file; expected a run's folder, such as results"
        )
    if check_place(place, checked):
        return checked
    for root in _roots(folder):
        _check_below(root, checked)
    if not checked.stores + checked.manifests + checked.files and not checked.notes:
        raise InputError(
            f"{folder}: holds nothing of a run; expected results, one of its folders, a "
            "calibration or a published folder"
        )
    return checked


def bytes_below(folder: Path) -> int:
    """Return the bytes of all files that a check may read."""
    return sum(
        file.stat().st_size
        for root in _roots(folder)
        for file in root.rglob("*")
        if file.is_file() and not file.is_symlink()
    )


def command_for(finding: Finding) -> str:
    """Return the shell command that mends a finding; none where only a copy does."""
    if finding.mend.how == "restore":
        return ""
    path = Path(str(finding.path)).absolute()
    results = next((each for each in (path, *path.parents) if each.name == "results"), path.parent)
    again = run_again(results)
    if finding.mend.how == "calibrate":
        of_steps = (each.parent for each in path.parents if each.name == "steps")
        again = f"rfpipe calibrate RIG.yaml --output {shell_path(next(of_steps, path.parent))}"
    if not finding.mend.remove:
        return again
    return f"rm -rf {' '.join(map(shell_path, finding.mend.remove))} && {again}"


def _roots(folder: Path) -> list[Path]:
    inside = [place for place in (folder / "results", folder / "calibration") if place.is_dir()]
    return inside if (folder / "results").is_dir() else [folder]


def _check_below(folder: Path, checked: Checked) -> None:
    """Check a folder and all below it."""
    if folder.name in _LEFT_OUT or folder in checked.seen:
        return
    if folder.suffix == ".zarr":
        _check_alone(folder, checked)
        return
    is_acquisition = (folder / "transport.json").is_file() or (folder / "L00").is_dir()
    if is_acquisition:
        holder = StoreLock.holder(folder)
        if holder is not None and holder.is_known:
            checked.notes.append(f"{folder}: is being acquired at this moment; not checked")
            return
    for manifest in sorted(folder.glob("*.json")):
        if _is_manifest(manifest):
            _check_manifest(manifest, checked)
    for inner in sorted(folder.iterdir()):
        if inner.is_dir() and not inner.is_symlink():
            _check_below(inner, checked)
    if is_acquisition:
        _check_acquisition(folder, checked)


def _is_manifest(path: Path) -> bool:
    if path.name == RUN or path.with_suffix(".zarr").exists():
        return True
    content = path.read_bytes()
    if b'"checksum"' not in content:
        return False
    try:
        return "checksum" in json.loads(content)
    except ValueError:
        return True


def _read(path: Path, checked: Checked, mend: Mend) -> dict[str, Any]:
    """Read a manifest; nothing where it is missing or damaged, which is a finding."""
    checked.manifests += 1
    try:
        checked.facts[path] = read_manifest(path)
    except StoreError as error:
        checked.wrong(path, damage_of(error, path), mend)
    return checked.facts.get(path, {})


def _check_manifest(path: Path, checked: Checked) -> None:
    """Check a manifest by itself, and the stores and files beside it that it is about."""
    facts = _read(path, checked, _mend(path))
    if not facts:
        return  # its stores are checked alone
    entries = {path.stem: facts, **{key: it for key, it in facts.items() if isinstance(it, dict)}}
    for name, entry in entries.items():
        store = path.with_name(f"{name}.zarr")
        # a calibration calls the digest of its store arrays
        stated = next((entry[key] for key in ("digest", "arrays") if key in entry), None)
        is_told = entry is facts or name in _OWNERS
        is_due = stated or store.exists() or facts.get("stage") == "schedule"
        if store in checked.seen or not (is_told and is_due):
            continue
        damage, digest = check_store(store, checked, entry.get("fingerprint"))
        if stated and digest not in (None, stated):
            damage.append(f"isn't the store of {path.name}: its digest is {digest}, not {stated}")
        of_patterns = facts.get("stage") == "schedule" and not damage
        if of_patterns and open_arrays(store).attributes["facts"] != facts:
            damage.append(f"holds other patterns than {path.name} says")
        for what in damage:
            checked.wrong(store, what, _mend(path, store))
    for name, digest in facts.get("files", {}).items():
        file = path.parent / name
        checked.files += 1
        if not file.is_file():
            checked.wrong(file, "is missing", _mend(path, file))
        elif digest_of(file.read_bytes()) != digest:
            what = f"is altered: its digest isn't that of {path.name}"
            checked.wrong(file, what, _mend(path, file))
        else:
            checked.read(file.stat().st_size)


def _check_alone(path: Path, checked: Checked) -> None:
    """Check a store that no whole manifest tells of: one kept aside, a recording, a user's own."""
    manifest = path.with_name(f"{_OWNERS.get(path.stem, path.stem)}.json")
    for what in check_store(path, checked)[0]:
        if "not in its journal" in what:  # an interrupted capture
            checked.notes.append(f"{path}: {what}")
        else:
            checked.wrong(path, what, _mend(manifest, path) if manifest.exists() else RESTORE)


def _check_acquisition(folder: Path, checked: Checked) -> None:
    """Check that the levels of an acquisition are whole, and its transport is made of them."""
    levels = sorted(place for place in folder.glob("L*") if _LEVEL.fullmatch(place.name))
    transport = folder / "transport.json"
    for level in levels:
        _check_level(level, _STAGES, checked, is_complete=transport.exists())
    if (folder / "verification").is_dir():
        is_complete = (folder / VERIFICATION).exists()
        _check_level(folder / "verification", _STAGES[:3], checked, is_complete=is_complete)
    if not transport.exists():
        checked.notes.append(
            f"{folder}: not finished, {len(levels)} levels begun; the next run goes on there"
        )
    elif "made_of" in (facts := checked.facts.get(transport, {})):
        for path, what in _strangers(folder, levels, facts, checked.facts):
            checked.wrong(path, what, _mend(path if path.suffix == ".json" else transport))


def _check_level(
    level: Path, stages: Sequence[str], checked: Checked, *, is_complete: bool
) -> None:
    of_level: dict[str, dict[str, Any]] = {}
    for stage in stages:
        manifest = level / f"{stage}.json"
        facts = of_level[stage] = checked.facts.get(manifest, {})
        number = VERIFICATION_KEY if level.name == "verification" else int(level.name[1:])
        if is_complete and not manifest.exists():
            checked.wrong(manifest, "is missing", _mend(manifest))
        elif facts and (facts["stage"], facts["level"]) != (stage, number):
            what = f"is of {facts['stage']} of level {facts['level']}"
            checked.wrong(manifest, what, _mend(manifest))
    captured, merged = of_level["capture"], of_level["merge"]
    if captured and merged and merged["made_of"]["captured"] != captured["digest"]:
        merge = level / "merge.json"
        checked.wrong(merge, "is of another capture", _mend(merge))


def _strangers(
    folder: Path, levels: list[Path], facts: dict[str, Any], manifests: dict[Path, dict[str, Any]]
) -> Iterator[tuple[Path, str]]:
    """Yield what doesn't belong to the transport of an acquisition, and why."""
    transport, place = folder / "transport.json", folder.resolve()
    names = facts["scene"], facts["method"]
    if names != (place.parent.name, place.name) and place.parents[1].name == "results":
        yield transport, f"is of {names[0]} by {names[1]}, not of this folder"
    for number, digest in facts["made_of"]["refine"]:
        refined = folder / f"L{number:02d}" / "refine.json"
        if refined.parent not in levels:
            yield refined.parent, "is missing"
        elif manifests.get(refined, {"digest": digest})["digest"] != digest:
            of = refined.relative_to(folder)
            yield transport, f"was made of another {of} than stands there"
    references = manifests.get(folder / "L00" / "merge.json", {}).get(REFERENCES)
    if references and references["digest"] != facts["made_of"]["references"]:
        yield transport, "was made with another floodlit image than stands there"
    for path, about in manifests.items():
        if path.parent == folder and about.get("transport", facts["digest"]) != facts["digest"]:
            yield path, "is of another transport than stands beside it"


def _mend(manifest: Path, damaged: Path | None = None) -> Mend:
    """Return what makes that anew which a manifest is about."""
    folder, name = manifest.parent, manifest.name
    if folder.name == "steps" or name == "calibration.json":
        return Mend("calibrate", (manifest,), "the step is measured again, with the rig")
    if "recorded" in manifest.parts:
        return Mend("run", (folder,), "the light of this scene is recorded again")
    if folder.name == "verification":
        return Mend("run", (manifest, folder.with_name(VERIFICATION)))
    if name == "sweep_times.json":
        gone = (manifest, *(folder / f"sweep.{suffix}" for suffix in ("json", "zarr", "csv")))
        return Mend("run", gone, "the sweep is acquired again")
    if name == FILES and (folder / "index.html").is_file():  # which the workflow knows of
        tables = tuple(each for each in (damaged,) if each and each.parent.name == "tables")
        return Mend("run", (*tables, folder / "index.html"))
    return _mend_level(manifest) if _LEVEL.fullmatch(folder.name) else Mend("run", (manifest,))


def _mend_level(manifest: Path) -> Mend:
    folder = manifest.parent
    transport = folder.with_name("transport.json")
    gone, cost = with_followers(manifest), ""
    if manifest.stem == "capture":
        cost = (
            "what is whole stays; the damaged patterns are shown again, so the scene must stand as "
            "it did"
        )
    elif manifest.stem == "merge" and (folder / "capture.zarr" / "dropped.json").exists():
        gone = [manifest, *_captured(folder.parent)]
        cost = (
            "the raw exposures were dropped after their merge (capture.keep_raw): ALL patterns are "
            "taken again. A copy of the folder, if there is one, is better"
        )
    return Mend("run", tuple(dict.fromkeys((*gone, transport))), cost)


def _captured(folder: Path) -> Iterator[Path]:
    """Yield the captures of an acquisition, and what is made of them."""
    for level in folder.glob("L*"):
        stores = (level / f"{name}.zarr" for name in ("capture", REFERENCE, SYMMETRY))
        for place in (*with_followers(level / "capture.json"), *stores):
            if place.exists():
                yield place
