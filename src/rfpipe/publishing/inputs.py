"""User files that a run's settings name: code of methods and scenes, and data of scenes.

A publication has them in `INPUTS_FOLDER`, at their paths relative to the run's folder. The settings
are valid in a new run's folder with a copy of this content.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from os.path import commonpath
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rfpipe.errors import InputError
from rfpipe.provenance import source_digest
from rfpipe.publishing.run import FinishedAcquisition, files_below

INPUTS_FOLDER = "inputs"
"""Folder of the files in a publication."""

OUTSIDE = "outside"
"""Subfolder for files from outside the run's folder."""

_CLASS = re.compile(r"(?P<file>.+\.py)?(?P<module>[A-Za-z_]\w*(\.\w+)*)?:[A-Za-z_]\w*")
_INSTALLED = ("site-packages", "dist-packages")
_OF_RFPIPE = "rfpipe"
# Sections of settings whose values may name a user's classes and files.
_SECTIONS = ("scenes", "methods")
# Options that name a class, and options that name an output folder.
_CLASSES, _OUTPUTS = ("kind", "method"), ("cache",)


@dataclass(frozen=True)
class UserFiles:
    """User files of a publication, and the settings that name them.

    Attributes
    ----------
    settings : dict
        Plain data; files outside the run's folder have the paths of their copies.
    files : dict of str to Path
        Files by their names in the publication.
    notes : list of str
        Files and modules that are missing in the publication, with the reason.
    classes : dict of str to Path
        Source files of classes, by the setting that names the class.
    """

    settings: dict[str, Any]
    files: dict[str, Path]
    notes: list[str]
    classes: dict[str, Path]

    def check_sources(self, acquisitions: Iterable[FinishedAcquisition]) -> None:
        """Raise InputError where a class' file has changed since the acquisition."""
        for acquisition in acquisitions:
            scene, method = f"scenes.{acquisition.scene}", acquisition.method
            settings = {
                "scene": (f"{scene}.kind",),
                "method": (f"{scene}.methods.{method}.method", f"methods.{method}.method"),
            }
            for role, digest in acquisition.facts.get("sources", {}).items():
                file = next(filter(None, map(self.classes.get, settings[role])), None)
                if file is not None and source_digest(file) != digest:
                    raise InputError(
                        f"{file}: was edited after it made {acquisition.name}. Run again with "
                        "'rfpipe run', or restore the file, then publish"
                    )


def inputs_of(folder: Path, settings: dict[str, Any]) -> UserFiles:
    """Find the user files that the settings of a run's scenes and methods name.

    Parameters
    ----------
    folder : Path
        The run's folder, to which paths are relative.
    settings : dict
        Plain data.
    """
    finder = _Finder(folder.resolve())
    published = {
        section: _replaced(values, section, finder.replacement) if section in _SECTIONS else values
        for section, values in settings.items()
    }
    return UserFiles(published, finder.files, finder.notes, finder.classes)


def _replaced(value: Any, place: str, replacement: Callable[[str, str], str]) -> Any:
    """Replace all texts in settings; `place` is the path of `value` in the settings."""
    if isinstance(value, dict):
        return {
            key: item if key in _OUTPUTS else _replaced(item, f"{place}.{key}", replacement)
            for key, item in value.items()
        }
    return replacement(place, value) if isinstance(value, str) else value


class _Finder:
    """Collects the files that texts of settings name; attributes as in `UserFiles`."""

    def __init__(self, folder: Path) -> None:
        self.files: dict[str, Path] = {}
        self.notes: list[str] = []
        self.classes: dict[str, Path] = {}
        self._folder = folder
        self._roots: dict[Path, str] = {}

    def replacement(self, place: str, text: str) -> str:
        """Add the files that a text names; return its replacement in the published settings."""
        if place.rpartition(".")[2] not in _CLASSES:
            return self._data(place, text)
        match = _CLASS.fullmatch(text)
        if match is None:  # a name of rfpipe
            return text
        if match["file"]:
            file = self._folder / match["file"]
            if not file.is_file():
                self._note(place, text, f"there is no file {match['file']} in {self._folder}")
                return text
            self.classes[place] = file
            return f"{self._code(file)}:{text.rpartition(':')[2]}"
        self._module(place, text, match["module"])
        file = self._folder.joinpath(*match["module"].split("."))
        for source in (file.with_suffix(".py"), file / "__init__.py"):
            if source in self.files.values():
                self.classes[place] = source
        return text

    def _note(self, place: str, text: str, reason: str) -> None:
        self.notes.append(f"{place} is {text}: {reason}")

    def _data(self, place: str, text: str) -> str:
        """Add a file or Zarr folder of data, and the files that an XML scene names."""
        if "\n" in text or not text or not (self._folder / text).exists():
            return text
        path = (self._folder / text).resolve()
        if path.is_dir():
            if path.suffix == ".zarr":
                return self._add([path], path)
            return text
        files = [path]
        if path.suffix.lower() == ".xml":
            files += self._referenced_files(place, path)
        return self._add(files, path)

    def _referenced_files(self, place: str, scene: Path) -> list[Path]:
        """List the files that a scene of Mitsuba names: meshes, textures, included scenes."""
        files: list[Path] = []
        for text in _texts_of(scene):
            path = scene.parent / text
            if not path.is_file():
                continue
            if Path(text).is_absolute():
                self._note(place, text, f"{scene.name} names it by an absolute path")
            elif (path := path.resolve()) not in files:
                files.append(path)
                if path.suffix.lower() == ".xml":
                    files += self._referenced_files(place, path)
        return files

    def _add(self, paths: list[Path], named: Path) -> str:
        """Add related files; return the path of `named`, one of them, in the published settings."""
        root = self._folder
        if not all(path.is_relative_to(root) for path in paths):
            root = Path(commonpath([path.parent for path in paths]))
            name = self._roots.setdefault(root, f"{OUTSIDE}/{len(self._roots) + 1}")
        else:
            name = ""
        for path in paths:
            inside = "/".join(part for part in (name, path.relative_to(root).as_posix()) if part)
            if path.is_dir():
                self.files |= dict(files_below(path, f"{INPUTS_FOLDER}/{inside}"))
            else:
                self.files[f"{INPUTS_FOLDER}/{inside}"] = path
        return "/".join(part for part in (name, named.relative_to(root).as_posix()) if part)

    def _code(self, file: Path) -> str:
        """Add a Python file, and the modules in the run's folder that it imports."""
        for name in _imports(file):
            self._local_module(name)
        return self._add([file.resolve()], file.resolve())

    def _module(self, place: str, text: str, name: str) -> None:
        """Add a module in the run's folder or on Python's path, unless it is installed."""
        package = name.partition(".")[0]
        if package == _OF_RFPIPE or self._local_module(name):
            return
        try:
            spec = find_spec(package)
        except (ImportError, ValueError):
            spec = None
        if spec is None or spec.origin is None:
            self._note(place, text, f"there is no module {package} on this machine")
            return
        file = Path(spec.origin)
        if any(part in _INSTALLED for part in file.parts):
            self._note(
                place, text, f"{package} is an installed package; readers must install it, too"
            )
            return
        home = file.parents[1] if file.name == "__init__.py" else file.parent
        self._add_module(home, package)

    def _local_module(self, name: str) -> bool:
        """Add a module or package in the run's folder; False if there is none of this name."""
        package = name.partition(".")[0]
        file, folder = self._folder / f"{package}.py", self._folder / package
        if not file.is_file() and not any(folder.glob("*.py")):
            return False
        self._add_module(self._folder, package)
        return True

    def _add_module(self, home: Path, package: str) -> None:
        """Add a module or package at its path relative to `home`, and local imports."""
        file, folder = home / f"{package}.py", home / package
        files = [file] if file.is_file() else [path for _, path in files_below(folder, "")]
        for path in files:
            name = f"{INPUTS_FOLDER}/{path.relative_to(home).as_posix()}"
            if name in self.files:
                continue
            self.files[name] = path
            for module in _imports(path) if path.suffix == ".py" else ():
                self._local_module(module)


def _texts_of(scene: Path) -> Iterator[str]:
    """Yield the attributes of an XML file that may name files: values and included files."""
    try:
        elements = list(ElementTree.parse(scene).iter())
    except ElementTree.ParseError:
        return
    for element in elements:
        yield from filter(None, (element.get("value"), element.get("filename")))


def _imports(file: Path) -> Iterator[str]:
    """Yield the names of the modules that a Python file imports.

    Raises InputError where the file isn't Python.
    """
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None)
        place = f"{file}, line {line}" if line else f"{file}"
        raise InputError(
            f"{place}: isn't Python: {getattr(error, 'msg', error)}. Correct the file and run "
            "again, or restore it"
        ) from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
