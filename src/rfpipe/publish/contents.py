"""What of a run is published, and under which names."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from rfpipe.config import load_config, parse_config
from rfpipe.config.model import ReportConfig
from rfpipe.errors import ConfigError, InputError, IntegrityError
from rfpipe.store import open_arrays, read_manifest
from rfpipe.store.chunks import METADATA
from rfpipe.store.packed import INDEX
from rfpipe.transport.places import STORE_NAME, transports_in

__all__ = ["SETTINGS", "Acquisition", "Run", "files_of_store", "find_run", "settings_of"]

_RESULTS = "results"
_TO_LOGS = re.compile(rb' <a href="[^"]*\.log">log</a>')  # which stay at home
_MOST_NAMED = 6
_LEFT_OUT = (".log", ".benchmark.tsv", ".asked", ".tmp")

SETTINGS = "settings.yaml"
"""Under which the settings are published."""


@dataclass(frozen=True)
class Acquisition:
    """A scene acquired by a method.

    Attributes
    ----------
    scene, method : str
    folder : Path
        Where it lies.
    facts : dict
        The manifest of its transport.
    """

    scene: str
    method: str
    folder: Path
    facts: dict[str, Any]

    @property
    def name(self) -> str:
        """Folder in a publication."""
        return f"{_RESULTS}/{self.scene}/{self.method}"

    @property
    def store(self) -> Path:
        """Where its transport lies."""
        return self.folder / STORE_NAME

    def check(self) -> None:
        """Check that the transport is whole, and the one that its manifest is about.

        Raises
        ------
        IntegrityError
        """
        bundle = open_arrays(self.store)
        if bundle.digest != self.facts["digest"]:
            raise IntegrityError(
                f"{self.store}: has the digest {bundle.digest}; its manifest says "
                f"{self.facts['digest']}. Run 'rfpipe verify', which tells what mends it"
            )
        for name in bundle.names:
            bundle.read(name)


@dataclass(frozen=True)
class Run:
    """A run's folder.

    Attributes
    ----------
    folder : Path
        Holds ``results``.
    acquisitions : list of Acquisition
        Those that have a transport, by scene and method.
    settings : dict, optional
        All settings that shape its results, as plain data; None if it left no report.
    """

    folder: Path
    acquisitions: list[Acquisition]
    settings: dict[str, Any] | None = field(default=None)

    @property
    def results(self) -> Path:
        """Where its results lie."""
        return self.folder / _RESULTS

    @property
    def report(self) -> Path | None:
        """Its report's folder, if there is one."""
        report = self.results / "report"
        return report if (report / "index.html").is_file() else None

    @property
    def incomplete(self) -> list[str]:
        """Scenes and methods whose acquisition has begun but has no transport yet."""
        begun = {folder.parent for folder in self.results.glob("*/*/L00") if folder.is_dir()}
        left = begun - {found.folder for found in self.acquisitions}
        return sorted(f"{folder.parent.name} by {folder.name}" for folder in left)

    @property
    def title(self) -> str:
        """The report's title, if it was given one, or one made of the scenes' names."""
        titled = (self.settings or {}).get("report", {}).get("title")
        if titled and titled != ReportConfig().title:
            return str(titled)
        return f"Light transport of {self.scenes}"

    @property
    def scenes(self) -> str:
        """The scenes' names, or how many there are, for people."""
        names = [*dict.fromkeys(found.scene for found in self.acquisitions)]
        if len(names) <= _MOST_NAMED:
            return ", ".join(names)
        return f"{len(names):,} scenes, {names[0]} to {names[-1]}"

    @property
    def times(self) -> tuple[str, str]:
        """When it began and ended, in UTC, as its manifests' files say."""
        files = [
            file for found in self.acquisitions for file in found.folder.rglob("*.json")
            if file.parent.suffix != ".zarr" and file.name != METADATA
        ]  # fmt: skip
        seconds = [file.stat().st_mtime for file in files]
        first, last = (datetime.fromtimestamp(int(t), UTC) for t in (min(seconds), max(seconds)))
        return first.isoformat(), last.isoformat()

    def report_files(self) -> Iterator[tuple[str, Path | bytes]]:
        """Yield name and place, or content, of the pages: report, viewers and catalogue."""
        pages = self.report or self.results / "report" / "view"
        if pages.is_dir():
            yield from self._below(pages)
        folder = self.results / "catalogue"
        for name, file in self._below(folder) if folder.is_dir() else ():
            if file.suffix == ".html":
                yield name, _TO_LOGS.sub(b"", file.read_bytes())
            elif file.suffix != ".json":
                yield name, file

    def manifests(self) -> Iterator[tuple[str, Path]]:
        """Yield name and place of the stages' manifests: what was captured, and its digests.

        They go to a folder of their own, since the stores that they are about stay at home.
        """
        for found in self.acquisitions:
            for file in sorted(found.folder.rglob("*.json")):
                inside = file.relative_to(found.folder)
                in_store = any(part.endswith(".zarr") for part in inside.parts)
                if not in_store and inside.as_posix() != "transport.json":
                    yield f"provenance/{found.scene}/{found.method}/{inside.as_posix()}", file

    def captured(self) -> Iterator[tuple[str, Path]]:
        """Yield name and place of all that the acquisitions left, the captured frames too."""
        for found in self.acquisitions:
            for name, file in self._below(found.folder):
                if f"/{STORE_NAME}/" not in name and not name.endswith("/transport.json"):
                    yield name, file

    def _below(self, folder: Path) -> Iterator[tuple[str, Path]]:
        for file in sorted(folder.rglob("*")):
            inside = file.relative_to(self.folder)
            hidden = any(part.startswith(".") for part in inside.parts)
            if file.is_file() and not hidden and not file.name.endswith(_LEFT_OUT):
                yield inside.as_posix(), file


def find_run(folder: Path) -> Run:
    """Look at the folder of a run, or at its ``results``.

    Raises
    ------
    InputError
        When no acquisition's transport lies there.
    """
    folder = folder.resolve()
    if folder.name == _RESULTS:
        folder = folder.parent
    found = []
    for name in transports_in(folder / _RESULTS):
        parts = name.split("/")
        if len(parts) != 3:  # a study's, not an acquisition's
            continue
        scene, method, _ = parts
        place = folder / _RESULTS / scene / method
        facts = read_manifest(place / "transport.json")
        found.append(Acquisition(scene, method, place, facts))
    packed = [place for place in (folder, folder / _RESULTS) if (place / INDEX).is_file()]
    if packed and not found:
        raise InputError(
            f"{packed[0]}: is a packed run; publish it as it was: 'rfpipe collection unpack "
            f"{packed[0]} -o {folder}_whole/{_RESULTS}', then 'rfpipe publish {folder}_whole'. Or "
            "give the packed folder itself to others, with its list of SHA-256: "
            "rfpipe.open_collection reads it"
        )
    if not found:
        raise InputError(
            f"{folder}: has no {_RESULTS}/<scene>/<method>/{STORE_NAME}; give the folder of a run, "
            "in which 'results' lies, after the run is complete"
        )
    return Run(folder, found, _settings_in(folder / _RESULTS / "report" / "results.json"))


def files_of_store(store: Path, name: str) -> Iterator[tuple[str, Path]]:
    """Yield name and place of a store's files, in the order in which they are read.

    What describes the whole comes first, and what describes an array before its numbers, so that
    few ranges of a zip file hold all of it.
    """
    files = [file for file in store.rglob("*") if file.is_file()]

    def order(file: Path) -> tuple[tuple[bool, str], ...]:
        inside = file.relative_to(store).parts
        return tuple((part != METADATA, part) for part in inside)

    for file in sorted(files, key=order):
        yield f"{name}/{file.relative_to(store).as_posix()}", file


def settings_of(run: Run, config: Path | None) -> bytes | None:
    """Return the settings that shaped a run's results, as a file of settings.

    What shapes no result (a server's address, a token's place, a command to notify) isn't in it.

    Raises
    ------
    InputError
        When the settings that are given aren't those of the run.
    """
    shaping = run.settings
    if config is not None:
        given = load_config(config).shaping()
        if shaping is not None and given != shaping:
            raise InputError(
                f"{config}: isn't what this run was made with, as its report says; leave --config "
                "out, and the settings are taken from the report"
            )
        shaping = given
    if shaping is None:
        return None
    text = yaml.safe_dump(
        _without_unset_methods(shaping), sort_keys=False, allow_unicode=True, width=98
    )
    head = "# All settings that shaped this run's results.\n"
    try:
        parse_config(yaml.safe_load(text), SETTINGS)
    except ConfigError:  # of another version of rfpipe
        head = "# All settings that shaped this run's results, by the rfpipe that made it.\n"
    return (head + text).encode()


def _settings_in(results: Path) -> dict[str, Any] | None:
    try:
        configuration: dict[str, Any] = json.loads(results.read_bytes())["provenance"][
            "configuration"
        ]
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:
        raise IntegrityError(
            f"{results}: damaged ({type(error).__name__}: {error}); remove the report and run again"
        ) from error
    return configuration


def _without_unset_methods(value: Any) -> Any:
    """Leave out each method section's empty name: as a section of the file it has one."""
    if isinstance(value, dict):
        return {
            name: _without_unset_methods(found)
            for name, found in value.items()
            if found is not None or name != "method"
        }
    return value
