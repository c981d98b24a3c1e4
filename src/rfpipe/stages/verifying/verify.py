"""Checking all that lies in a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, StoreError
from rfpipe.stages.verifying.acquisition import check_acquisition, is_acquisition
from rfpipe.stages.verifying.afar import check_afar
from rfpipe.stages.verifying.again import RUN, run_again, shell_path
from rfpipe.stages.verifying.findings import Checked, Finding, Mend
from rfpipe.stages.verifying.published import check_list, published
from rfpipe.stages.verifying.report_files import check_report_files
from rfpipe.stages.verifying.stores import check_store, first_sentence
from rfpipe.store import read_manifest
from rfpipe.store.places import Place, as_address, locate

__all__ = ["bytes_below", "command_for", "results_of", "verify"]

_LEFT_OUT = (".snakemake", ".git", ".venv", "bench")


def verify(folder: Path, progress: Callable[[int], object] | None = None) -> Checked:
    """Check every store, chunk, manifest and table below a folder.

    Parameters
    ----------
    folder : Path
        A run's (with ``results``), its results or one acquisition of them, a calibration, a store,
        or a published folder or zip with a list of its files; a zip file of a transport. Or the
        address of either.
    progress : callable, optional
        Called with the number of bytes that were read, as they are.

    Returns
    -------
    Checked

    Raises
    ------
    InputError
        When there is no such folder, or nothing in it that could be checked.
    StoreError
        When a server doesn't answer.
    """
    checked = Checked(progress=progress or (lambda _: None))
    if as_address(folder) is not None:
        place = locate(folder)
        assert isinstance(place, Place)
        check_afar(place, checked)
        return checked
    with published(folder) as files:
        if files is not None:
            check_list(files, checked)
            return checked
    if not folder.is_dir():
        place = locate(folder)
        if isinstance(place, Path):
            raise InputError(
                f"{folder}: is no folder and no zip file; expected a run's folder, such as results"
            )
        check_afar(place, checked)
        return checked
    for root in _roots(folder):
        _check_below(root, checked)
    if not checked.stores + checked.manifests + checked.files and not checked.notes:
        raise InputError(
            f"{folder}: holds nothing of a run; expected results, one of its folders, a "
            "calibration or a published folder"
        )
    return checked


def command_for(finding: Finding) -> str:
    """Return the shell command that mends a finding, or what is to be done where none can."""
    mend = finding.mend
    if mend.how == "restore":
        return ""
    again = (
        f"rfpipe calibrate RIG.yaml --output {shell_path(_calibration_of(finding.path))}"
        if mend.how == "calibrate"
        else run_again(results_of(finding))
    )
    if not mend.remove:
        return again
    return f"rm -rf {' '.join(map(shell_path, mend.remove))} && {again}"


def _calibration_of(found: Path | Place) -> Path:
    path = Path(str(found))
    return next((place.parent for place in path.parents if place.name == "steps"), path.parent)


def results_of(finding: Finding) -> Path:
    """Return the results' folder in which a finding lies."""
    path = Path(str(finding.path)).absolute()
    named = [place for place in (path, *path.parents) if place.name == "results"]
    return named[0] if named else path.parent


def bytes_below(folder: Path) -> int:
    """Return the bytes of all files that a check may read."""
    return sum(
        file.stat().st_size
        for root in _roots(folder)
        for file in root.rglob("*")
        if file.is_file() and not file.is_symlink()
    )


def _roots(folder: Path) -> list[Path]:
    inside = [folder / "results", folder / "calibration"]
    present = [place for place in inside if place.is_dir()]
    return present if (folder / "results").is_dir() else [folder]


def _check_below(folder: Path, checked: Checked) -> None:
    """Check a folder and all below it."""
    if folder.name in _LEFT_OUT or folder in checked.seen:
        return
    if folder.suffix == ".zarr":
        _check_alone(folder, checked)
        return
    if is_acquisition(folder):
        check_acquisition(folder, checked)
    if (folder / "results.json").is_file() and (folder / "index.html").is_file():
        check_report_files(folder, checked)
    for manifest in sorted(folder.glob("*.json")):
        if manifest not in checked.seen:
            _check_manifest(manifest, checked)
    for inner in sorted(folder.iterdir()):
        if inner.is_dir() and not inner.is_symlink():
            _check_below(inner, checked)


def _check_manifest(path: Path, checked: Checked) -> None:
    """Check a manifest by itself, and the store beside it that it is about."""
    store = path.with_suffix(".zarr")
    if not (store.exists() or _is_manifest(path)):
        return
    checked.manifests += 1
    checked.seen.add(path)
    mend = _mend(path)
    try:
        facts = read_manifest(path)
    except StoreError as error:
        checked.wrong(path, first_sentence(error, path), mend)
        facts = {}
    stated = next(_digests(facts), None)
    if store.exists() or stated is not None:
        wrong, digest = check_store(store, checked)
        for what in wrong:
            checked.wrong(store, what, mend)
        if digest is not None and stated is not None and digest != stated:
            what = f"isn't the store of {path.name}: its digest is {digest}, not {stated}"
            checked.wrong(store, what, mend)
    of = facts.get("transport")
    if of is not None and path.with_name("transport.json") in checked.seen:
        _is_of_transport(path, of, checked)


def _is_of_transport(path: Path, of: str, checked: Checked) -> None:
    try:
        acquired = read_manifest(path.with_name("transport.json"))
    except StoreError:
        return
    if acquired["digest"] != of:
        checked.wrong(path, "is of another transport than stands beside it", _mend(path))


def _check_alone(path: Path, checked: Checked) -> None:
    """Check a store that no manifest tells of: one kept aside, a recording, a user's own."""
    manifest = path.with_suffix(".json")
    mend = _mend(manifest) if manifest.exists() else Mend("restore")
    for what in check_store(path, checked)[0]:
        if "not in its journal" in what:  # an interrupted capture that was kept aside
            checked.notes.append(f"{path}: {what}")
        else:
            checked.wrong(path, what, mend)


def _mend(manifest: Path) -> Mend:
    if manifest.parent.name == "steps" or manifest.name == "calibration.json":
        return Mend("calibrate", (manifest,), "the step is measured again, with the rig")
    if "recorded" in manifest.parts:
        return Mend("run", (manifest.parent,), "the light of this scene is recorded again")
    return Mend("run", (manifest,))


def _is_manifest(path: Path) -> bool:
    if path.name == RUN:
        return True
    content = path.read_bytes()
    if b'"checksum"' not in content:
        return False
    try:
        return "checksum" in json.loads(content)
    except ValueError:
        return True


def _digests(facts: dict[str, Any]) -> Iterator[str]:
    """Return what a manifest says the digest of its store is; a calibration's are called arrays."""
    for name in ("digest", "arrays"):
        if isinstance(facts.get(name), str):
            yield facts[name]
