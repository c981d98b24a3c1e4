"""The files of a run, and their names in a publication."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from rfpipe.config import load_config
from rfpipe.errors import InputError, IntegrityError
from rfpipe.publishing.writing import Source
from rfpipe.storage.files import BY_PRODUCTS, FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.store import open_arrays, read_manifest
from rfpipe.store.packed import packed_in
from rfpipe.store.places import METADATA
from rfpipe.transport.storage import STORE_NAME, transports_in

SETTINGS = "settings.yaml"
"""Name of the settings in a publication."""

_TO_LOGS = re.compile(rb' <a href="[^"]*\.log">log</a>')  # logs aren't published


@dataclass(frozen=True)
class FinishedAcquisition:
    """A complete acquisition of a scene by a method; `facts` is its transport's manifest."""

    scene: str
    method: str
    folder: Path
    facts: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of its folder in a publication."""
        return f"results/{self.scene}/{self.method}"

    @property
    def store_name(self) -> str:
        """Name of its transport in a publication."""
        return f"{self.name}/{STORE_NAME}"

    @property
    def description(self) -> str:
        """One-line description of the transport."""
        return f"light transport of {self.scene} by {self.method}, {self.cost} (zarr 3)"

    @property
    def cost(self) -> str:
        """Number of patterns, and of pictures on the rig for all purposes, as text."""
        pictures = captured_pictures(FolderStorage(self.folder)).total
        return f"{self.facts['patterns']:,} patterns, {pictures:,} pictures on the rig"

    def check(self) -> None:
        """Verify the transport's data and its digest in the manifest, or raise IntegrityError."""
        store = self.folder / STORE_NAME
        bundle = open_arrays(store)
        if bundle.digest != self.facts["digest"]:
            raise IntegrityError(
                f"{store}: has the digest {bundle.digest}; its manifest says "
                f"{self.facts['digest']}. Run 'rfpipe verify' to find out how to repair it"
            )
        for name in bundle.names:
            bundle.read(name)


@dataclass(frozen=True)
class RunFolder:
    """A folder with ``results``; the settings are None if there is no report."""

    folder: Path
    acquisitions: list[FinishedAcquisition]
    settings: dict[str, Any] | None

    @property
    def results(self) -> Path:
        """Folder of the results."""
        return self.folder / "results"

    @property
    def incomplete(self) -> list[str]:
        """Acquisitions that have started but have no transport yet, as ``scene by method``."""
        started = {folder.parent for folder in self.results.glob("*/*/L00") if folder.is_dir()}
        folders = started - {acquisition.folder for acquisition in self.acquisitions}
        return sorted(f"{folder.parent.name} by {folder.name}" for folder in folders)

    @property
    def title(self) -> str:
        """The report's title in the settings, or a title with the scenes' names."""
        title = (self.settings or {}).get("report", {}).get("title")
        if title:
            return str(title)
        names = [*dict.fromkeys(acquisition.scene for acquisition in self.acquisitions)]
        return f"Light transport of {', '.join(names[:6])}{' and more' * (len(names) > 6)}"

    @property
    def times(self) -> tuple[str, str]:
        """Begin and end in UTC, by the modification times of its manifests."""
        files = [acquisition.folder / "transport.json" for acquisition in self.acquisitions]
        seconds = [file.stat().st_mtime for file in [*files, *dict(self.manifests()).values()]]
        first, last = (datetime.fromtimestamp(int(t), UTC) for t in (min(seconds), max(seconds)))
        return first.isoformat(), last.isoformat()

    def report_files(self) -> Iterator[tuple[str, Source]]:
        """Yield name and source of the pages of report, viewers and catalogue."""
        report = "results/report"
        if not (self.folder / report / "index.html").is_file():
            report += "/view"
        yield from files_below(self.folder / report, report)
        for name, file in files_below(self.results / "catalogue", "results/catalogue"):
            if file.suffix == ".html":
                yield name, _TO_LOGS.sub(b"", file.read_bytes())
            elif file.suffix != ".json":
                yield name, file

    def captured(self) -> Iterator[tuple[str, Path]]:
        """Yield name and path of all files of the acquisitions except transports."""
        for acquisition in self.acquisitions:
            for name, file in files_below(acquisition.folder, acquisition.name):
                if f"/{STORE_NAME}/" not in name and not name.endswith("/transport.json"):
                    yield name, file

    def manifests(self) -> Iterator[tuple[str, Path]]:
        """Yield name and path of the stages' manifests, whose stores aren't published."""
        for name, file in self.captured():
            if file.suffix == ".json" and ".zarr/" not in name:
                yield name.replace("results/", "provenance/", 1), file


def files_below(folder: Path, name: str) -> Iterator[tuple[str, Path]]:
    """Yield name and path of a folder's files except logs, in the order in which stores are read.

    Metadata precede data, so that few ranges of a zip file contain all metadata.
    """
    files = [file.relative_to(folder) for file in folder.rglob("*") if file.is_file()]
    for inside in sorted(files, key=lambda file: [(part != METADATA, part) for part in file.parts]):
        hidden = any(part.startswith((".", "__pycache__")) for part in inside.parts)
        if not hidden and not inside.name.endswith(BY_PRODUCTS):
            yield f"{name}/{inside.as_posix()}", folder / inside


def find_run(folder: Path) -> RunFolder:
    """Find the acquisitions of a run, by its folder or its ``results``; InputError if none."""
    folder = folder.resolve()
    if folder.name == "results":
        folder = folder.parent
    items = []
    for name in transports_in(folder / "results"):
        scene, method, *more = name.split("/")
        if len(more) == 1:  # deeper ones belong to studies
            path = folder / "results" / scene / method
            items.append(
                FinishedAcquisition(scene, method, path, read_manifest(path / "transport.json"))
            )
    if not items:
        if packed_in(folder) or packed_in(folder / "results"):
            raise InputError(
                f"{folder}: is a packed run; unpack it by 'rfpipe collection unpack' and publish "
                "the result, or share the packed folder itself, which rfpipe.open_collection reads"
            )
        raise InputError(
            f"{folder}: has no results/<scene>/<method>/{STORE_NAME}; give the folder of a "
            "complete run, which contains 'results'"
        )
    results = folder / "results/report/results.json"
    settings: dict[str, Any] | None = None
    try:
        if results.exists():
            settings = json.loads(results.read_bytes())["provenance"]["configuration"]
    except (ValueError, KeyError, TypeError) as error:
        raise IntegrityError(
            f"{results}: damaged ({type(error).__name__}: {error}); remove the report and run again"
        ) from error
    return RunFolder(folder, items, settings)


def settings_of(run: RunFolder, config: Path | None) -> dict[str, Any] | None:
    """Return the settings that affect a run's results, from its report or else a file.

    Settings without effect on results, such as the server's address, are omitted.
    """
    if run.settings or config is None:
        return run.settings
    path = config.absolute()
    with chdir(run.folder):  # paths in settings are relative to it
        return load_config(path).result_settings()


def settings_file(settings: dict[str, Any]) -> bytes:
    """Format settings as the content of a YAML file."""
    text = yaml.safe_dump(
        _without_unset_methods(settings), sort_keys=False, allow_unicode=True, width=98
    )
    return f"# All settings that affect this run's results.\n{text}".encode()


def _without_unset_methods(value: Any) -> Any:
    """Remove the empty name of each method section, which a settings file doesn't need."""
    if not isinstance(value, dict):
        return value
    values = {name: _without_unset_methods(item) for name, item in value.items()}
    return {k: item for k, item in values.items() if item is not None or k != "method"}
