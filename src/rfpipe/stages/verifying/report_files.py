"""The files of a report with their digests: written by the report stage, checked by `verify`."""

from __future__ import annotations

from pathlib import Path

from rfpipe.errors import StoreError
from rfpipe.stages.verifying.findings import Checked, Mend
from rfpipe.stages.verifying.stores import first_sentence
from rfpipe.store import read_manifest, write_manifest
from rfpipe.store.files import digest_of

__all__ = ["FILES", "check_report_files", "write_report_files"]

FILES = "files.json"
"""Lies in the report's folder."""

_SUFFIXES = (".csv", ".exr", ".html", ".json", ".png")
_PAGE = "index.html"
_EVALUATED = ("tables/errors.csv", "tables/speed_error.csv")


def write_report_files(folder: Path) -> None:
    """Write the digests of a report's page, tables, figures and numbers.

    Raises
    ------
    StoreError
        When the disk is full or the folder isn't writable.
    """
    write_manifest(folder / FILES, {"stage": "report", "files": _digests(folder)})


def check_report_files(folder: Path, checked: Checked) -> None:
    """Check a report's files against their digests."""
    manifest = folder / FILES
    checked.seen.add(manifest)
    if not manifest.is_file():
        checked.notes.append(
            f"{folder}: of an earlier version of rfpipe, without digests of its files"
        )
        return
    checked.manifests += 1
    try:
        stated = read_manifest(manifest)["files"]
    except StoreError as error:
        what = first_sentence(error, manifest)
        checked.wrong(manifest, what, Mend("run", (manifest, folder / _PAGE)))
        return
    found = _digests(folder)
    for name, digest in stated.items():
        checked.files += 1
        if found.get(name) == digest:
            checked.read((folder / name).stat().st_size)
            continue
        what = "is altered: its digest isn't that of files.json" if name in found else "is missing"
        # the page is what the workflow knows of; the evaluate stage's tables come before it
        gone = (folder / name, folder / _PAGE) if name in _EVALUATED else (folder / _PAGE,)
        checked.wrong(folder / name, what, Mend("run", gone))


def _digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): digest_of(path.read_bytes())
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix in _SUFFIXES and path.name != FILES
    }
