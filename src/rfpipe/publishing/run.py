"""What of a run is published, and under which names."""

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
from rfpipe.storage.files import BY_PRODUCTS
from rfpipe.store import open_arrays, read_manifest
from rfpipe.store.packed import packed_in
from rfpipe.store.places import METADATA
from rfpipe.transport.storage import STORE_NAME, transports_in

SETTINGS = "settings.yaml"
"""Under which the settings are published."""

_TO_LOGS = re.compile(rb' <a href="[^"]*\.log">log</a>')  # which stay at home


@dataclass(frozen=True)
class Acquisition:
    """A scene acquired by a method: its folder, and the manifest of its transport."""

    scene: str
    method: str
    folder: Path
    facts: dict[str, Any]

    @property
    def name(self) -> str:
        """Folder in a publication."""
        return f"results/{self.scene}/{self.method}"

    @property
    def store_name(self) -> str:
        """Name of its transport in a publication."""
        return f"{self.name}/{STORE_NAME}"

    @property
    def about(self) -> str:
        """What its transport is, for people."""
        patterns = f"{self.facts['patterns']:,} patterns"
        return f"light transport of {self.scene} by {self.method}, {patterns} (zarr 3)"

    def check(self) -> None:
        """Raise IntegrityError unless the transport is whole, and that of its manifest."""
        store = self.folder / STORE_NAME
        bundle = open_arrays(store)
        if bundle.digest != self.facts["digest"]:
            raise IntegrityError(
                f"{store}: has the digest {bundle.digest}; its manifest says "
                f"{self.facts['digest']}. Run 'rfpipe verify', which tells what mends it"
            )
        for name in bundle.names:
            bundle.read(name)


@dataclass(frozen=True)
class Run:
    """A run's folder, which holds ``results``; its settings are None where it left no report."""

    folder: Path
    acquisitions: list[Acquisition]
    settings: dict[str, Any] | None

    @property
    def results(self) -> Path:
        """Where its results lie."""
        return self.folder / "results"

    @property
    def incomplete(self) -> list[str]:
        """Scenes and methods whose acquisition has begun but has no transport yet."""
        begun = {folder.parent for folder in self.results.glob("*/*/L00") if folder.is_dir()}
        folders = begun - {acquisition.folder for acquisition in self.acquisitions}
        return sorted(f"{folder.parent.name} by {folder.name}" for folder in folders)

    @property
    def title(self) -> str:
        """The report's title, if it was given one, or one made of the scenes' names."""
        titled = (self.settings or {}).get("report", {}).get("title")
        if titled:
            return str(titled)
        names = [*dict.fromkeys(acquisition.scene for acquisition in self.acquisitions)]
        return f"Light transport of {', '.join(names[:6])}{' and more' * (len(names) > 6)}"

    @property
    def times(self) -> tuple[str, str]:
        """When it began and ended, in UTC, as its manifests' files say."""
        files = [acquisition.folder / "transport.json" for acquisition in self.acquisitions]
        seconds = [file.stat().st_mtime for file in [*files, *dict(self.manifests()).values()]]
        first, last = (datetime.fromtimestamp(int(t), UTC) for t in (min(seconds), max(seconds)))
        return first.isoformat(), last.isoformat()

    def report_files(self) -> Iterator[tuple[str, Source]]:
        """Yield name and source of the pages: report, viewers and catalogue."""
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
        """Yield name and place of all that the acquisitions left but the transports."""
        for acquisition in self.acquisitions:
            for name, file in files_below(acquisition.folder, acquisition.name):
                if f"/{STORE_NAME}/" not in name and not name.endswith("/transport.json"):
                    yield name, file

    def manifests(self) -> Iterator[tuple[str, Path]]:
        """Yield name and place of the stages' manifests, whose stores stay at home."""
        for name, file in self.captured():
            if file.suffix == ".json" and ".zarr/" not in name:
                yield name.replace("results/", "provenance/", 1), file


def files_below(folder: Path, name: str) -> Iterator[tuple[str, Path]]:
    """Yield name and place of a folder's files but logs, in the order in which stores are read.

    Metadata come before what they describe, so that few ranges of a zip file hold all of it.
    """
    files = [file.relative_to(folder) for file in folder.rglob("*") if file.is_file()]
    for inside in sorted(files, key=lambda file: [(part != METADATA, part) for part in file.parts]):
        hidden = any(part.startswith((".", "__pycache__")) for part in inside.parts)
        if not hidden and not inside.name.endswith(BY_PRODUCTS):
            yield f"{name}/{inside.as_posix()}", folder / inside


def find_run(folder: Path) -> Run:
    """Return the run of a folder, or of its ``results``; InputError when it has no transport."""
    folder = folder.resolve()
    if folder.name == "results":
        folder = folder.parent
    items = []
    for name in transports_in(folder / "results"):
        scene, method, *more = name.split("/")
        if len(more) == 1:  # else a study's, not an acquisition's
            place = folder / "results" / scene / method
            items.append(Acquisition(scene, method, place, read_manifest(place / "transport.json")))
    if not items:
        if packed_in(folder) or packed_in(folder / "results"):
            raise InputError(
                f"{folder}: is a packed run; publish what 'rfpipe collection unpack' makes of it. "
                "Or give the packed folder itself to others: rfpipe.open_collection reads it"
            )
        raise InputError(
            f"{folder}: has no results/<scene>/<method>/{STORE_NAME}; give the folder of a run, "
            "in which 'results' lies, after the run is complete"
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
    return Run(folder, items, settings)


def settings_of(run: Run, config: Path | None) -> dict[str, Any] | None:
    """Return the settings that shaped a run's results, of its report or else as given.

    What shapes no result (a server's address, a token's place, a command to notify) isn't in it.
    """
    if run.settings or config is None:
        return run.settings
    path = config.absolute()
    with chdir(run.folder):  # to which the settings' own paths are relative
        return load_config(path).result_settings()


def settings_file(shaping: dict[str, Any]) -> bytes:
    """Return the content of a file of settings."""
    text = yaml.safe_dump(
        _without_unset_methods(shaping), sort_keys=False, allow_unicode=True, width=98
    )
    return f"# All settings that shaped this run's results.\n{text}".encode()


def _without_unset_methods(value: Any) -> Any:
    """Leave out each method section's empty name: as a section of the file it has one."""
    if not isinstance(value, dict):
        return value
    values = {name: _without_unset_methods(of) for name, of in value.items()}
    return {name: of for name, of in values.items() if of is not None or name != "method"}
