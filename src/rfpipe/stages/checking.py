"""Checking a run's folder: every manifest, the stores it is about, and what they say of others."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, StoreError
from rfpipe.stages.capture import SENSOR
from rfpipe.stages.checked import (
    RESTORE,
    Checked,
    Finding,
    Mend,
    check_place,
    check_store,
    damage_of,
)
from rfpipe.stages.folder import FILES, REFERENCE, STAGES, SYMMETRY, with_followers
from rfpipe.stages.jobs.ends import RUN, run_again
from rfpipe.stages.merge import SUMS
from rfpipe.stages.merger import REFERENCES
from rfpipe.stages.verification import MANIFEST as VERIFICATION
from rfpipe.stages.watch import DRIFT, MOVES
from rfpipe.store import StoreLock, open_arrays, read_manifest
from rfpipe.store.files import digest_of
from rfpipe.store.places import as_address, locate
from rfpipe.units import VERIFICATION_KEY

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
        When there is nothing that could be checked; StoreError when a server doesn't answer.
    """
    checked = Checked(progress=progress or (lambda _: None))
    place = folder if folder.is_dir() and as_address(folder) is None else locate(folder)
    if isinstance(place, Path) and not place.is_dir():
        raise InputError(
            f"{folder}: is no folder and no zip file; expected a run's folder, such as results"
        )
    if check_place(place, checked):
        return checked
    inside = [each for each in (folder / "results", folder / "calibration") if each.is_dir()]
    for root in inside if (folder / "results").is_dir() else [folder]:
        _check_below(root, checked)
    if not checked.stores + checked.manifests + checked.files and not checked.notes:
        raise InputError(
            f"{folder}: holds nothing of a run; expected results, one of its folders, a "
            "calibration or a published folder"
        )
    return checked


def command_for(finding: Finding) -> str:
    """Return the shell command that mends a finding; none where only a copy does."""
    if finding.mend.how == "restore":
        return ""
    path = Path(str(finding.path)).absolute()
    if finding.mend.how == "calibrate":
        of_steps = (each.parent for each in path.parents if each.name == "steps")
        output = str(next(of_steps, path.parent))
        again = shlex.join(["rfpipe", "calibrate", "RIG.yaml", "--output", output])
    else:
        above = (each for each in (path, *path.parents) if each.name == "results")
        again = run_again(next(above, path.parent))
    gone = shlex.join(map(str, finding.mend.remove))
    return f"rm -rf {gone} && {again}" if gone else again


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
    try:
        return b'"checksum"' in content and "checksum" in json.loads(content)
    except ValueError:
        return True


def _check_manifest(path: Path, checked: Checked) -> None:
    """Check a manifest by itself, and the stores and files beside it that it is about."""
    checked.manifests += 1
    try:
        facts = checked.facts[path] = read_manifest(path)
    except StoreError as error:  # its stores are checked alone
        checked.wrong(path, damage_of(error, path), _mend(path))
        return
    entries = {path.stem: facts, **{key: it for key, it in facts.items() if isinstance(it, dict)}}
    for name, entry in entries.items():
        store = path.with_name(f"{name}.zarr")
        # a calibration calls the digest of its store arrays
        stated = next((entry[key] for key in ("digest", "arrays") if key in entry), None)
        is_told = entry is facts or name in _OWNERS
        of_patterns = facts.get("stage") == "schedule"
        if store in checked.seen or not (is_told and (stated or store.exists() or of_patterns)):
            continue
        damage, digest = check_store(store, checked, entry.get("fingerprint"))
        if stated and digest not in (None, stated):
            damage.append(f"isn't the store of {path.name}: its digest is {digest}, not {stated}")
        if of_patterns and not damage and open_arrays(store).attributes["facts"] != facts:
            damage.append(f"holds other patterns than {path.name} says")
        for what in damage:
            checked.wrong(store, what, _mend(path, store))
    for name, digest in facts.get("files", {}).items():
        file = path.parent / name
        content = file.read_bytes() if file.is_file() else None
        checked.files += 1
        checked.read(len(content or b""))
        if content is None:
            checked.wrong(file, "is missing", _mend(path, file))
        elif digest_of(content) != digest:
            what = f"is altered: its digest isn't that of {path.name}"
            checked.wrong(file, what, _mend(path, file))


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
        _check_level(level, STAGES, int(level.name[1:]), checked, transport.exists())
    pictures = folder / "verification"
    if pictures.is_dir():
        is_complete = (folder / VERIFICATION).exists()
        _check_level(pictures, STAGES[:3], VERIFICATION_KEY, checked, is_complete)
    if not transport.exists():
        checked.notes.append(
            f"{folder}: not finished, {len(levels)} levels begun; the next run goes on there"
        )
    elif "made_of" in (facts := checked.facts.get(transport, {})):
        for path, what in _strangers(folder, levels, facts, checked.facts):
            checked.wrong(path, what, _mend(path if path.suffix == ".json" else transport))


def _check_level(
    level: Path, stages: Sequence[str], number: int, checked: Checked, is_complete: bool
) -> None:
    of_level = {stage: checked.facts.get(level / f"{stage}.json", {}) for stage in stages}
    for stage, facts in of_level.items():
        manifest = level / f"{stage}.json"
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
    if name == FILES and (folder / "index.html").is_file():  # which the workflow knows of
        tables = tuple(each for each in (damaged,) if each and each.parent.name == "tables")
        return Mend("run", (*tables, folder / "index.html"))
    if not _LEVEL.fullmatch(folder.name):
        return Mend("run", (manifest,))
    gone, cost = tuple(with_followers(manifest)), ""
    if manifest.stem == "capture":
        cost = (
            "what is whole stays; the damaged patterns are shown again, so the scene must stand as "
            "it did"
        )
    elif manifest.stem == "merge" and (folder / "capture.zarr" / "dropped.json").exists():
        gone = (manifest, *_captured(folder.parent))
        cost = (
            "the raw exposures were dropped after their merge (capture.keep_raw): ALL patterns are "
            "taken again. A copy of the folder, if there is one, is better"
        )
    return Mend("run", tuple(dict.fromkeys((*gone, folder.with_name("transport.json")))), cost)


def _captured(folder: Path) -> Iterator[Path]:
    """Yield the captures of an acquisition, and what is made of them."""
    for level in folder.glob("L*"):
        stores = (level / f"{name}.zarr" for name in ("capture", REFERENCE, SYMMETRY))
        for place in (*with_followers(level / "capture.json"), *stores):
            if place.exists():
                yield place
