"""Files of a user's own that a run's settings name: code of methods and scenes, scenes' data.

A publication keeps them in `FOLDER`, each at its path in the run's folder, so that the settings
find them where that folder's content is copied into a new run's folder.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from os.path import commonpath
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rfpipe.errors import InputError
from rfpipe.provenance import source_digest
from rfpipe.publishing.run import Acquisition, files_below

FOLDER = "inputs"
"""Folder of a publication."""

OUTSIDE = "outside"
"""Folder in it of files that don't lie in the run's folder."""

_CLASS = re.compile(r"(?P<file>.+\.py)?(?P<module>[A-Za-z_]\w*(\.\w+)*)?:[A-Za-z_]\w*")
_INSTALLED = ("site-packages", "dist-packages")
_OF_RFPIPE = "rfpipe"
# Sections of settings whose values are names of classes and files of a user's own.
_SECTIONS = ("scenes", "methods")
# Options that name a class, and those that name a place to write to.
_CLASSES, _WRITTEN = ("kind", "method"), ("cache",)


@dataclass
class Inputs:
    """Files of a user's own, and the settings that name them.

    Attributes
    ----------
    settings : dict
        Plain data; paths of files outside the run's folder are those of their copies.
    files : dict of str to Path
        Files by their names in the publication.
    notes : list of str
        What could not be taken along.
    classes : dict of str to Path
        Files of the classes among them, by the setting that names the class.
    """

    settings: dict[str, Any]
    files: dict[str, Path] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    classes: dict[str, Path] = field(default_factory=dict)

    def check_made(self, acquisitions: Iterable[Acquisition]) -> None:
        """Raise InputError where a class' file isn't the code that made an acquisition."""
        for acquisition in acquisitions:
            scene, method = f"scenes.{acquisition.scene}", acquisition.method
            places = {
                "scene": (f"{scene}.kind",),
                "method": (f"{scene}.methods.{method}.method", f"methods.{method}.method"),
            }
            for role, digest in acquisition.facts.get("sources", {}).items():
                file = next(filter(None, map(self.classes.get, places[role])), None)
                if file is not None and source_digest(file) != digest:
                    raise InputError(
                        f"{file}: isn't the code that made {acquisition.name}: it was edited "
                        "after that run. Run again with 'rfpipe run', or restore the file as it "
                        "was, then publish"
                    )


def inputs_of(folder: Path, settings: dict[str, Any]) -> Inputs:
    """Return the files that the settings of a run's scenes and methods name.

    Parameters
    ----------
    folder : Path
        The run's folder, to which paths are relative.
    settings : dict
        Plain data.
    """
    inputs = Inputs(dict(settings))
    finder = _Finder(folder.resolve(), inputs)
    for section in _SECTIONS:
        if section in settings:
            inputs.settings[section] = _replaced(settings[section], section, finder.replacement)
    return inputs


def _replaced(value: Any, place: str, replacement: Callable[[str, str], str]) -> Any:
    """Return settings in which each text is replaced; `place` is its path in the settings."""
    if isinstance(value, dict):
        return {
            key: each if key in _WRITTEN else _replaced(each, f"{place}.{key}", replacement)
            for key, each in value.items()
        }
    return replacement(place, value) if isinstance(value, str) else value


class _Finder:
    """Finds the files behind texts of settings, and adds them to the inputs of a publication."""

    def __init__(self, folder: Path, inputs: Inputs) -> None:
        self._folder = folder
        self._inputs = inputs
        self._roots: dict[Path, str] = {}

    def replacement(self, place: str, text: str) -> str:
        """Add the files that a text names; return the text for the published settings."""
        if place.rpartition(".")[2] not in _CLASSES:
            return self._data(place, text)
        match = _CLASS.fullmatch(text)
        if match is None:  # a name of rfpipe's own
            return text
        if match["file"]:
            file = self._folder / match["file"]
            if not file.is_file():
                self._note(place, text, f"there is no file {match['file']} in {self._folder}")
                return text
            self._inputs.classes[place] = file
            return f"{self._code(file)}:{text.rpartition(':')[2]}"
        self._module(place, text, match["module"])
        file = self._folder.joinpath(*match["module"].split("."))
        for source in (file.with_suffix(".py"), file / "__init__.py"):
            if source in self._inputs.files.values():
                self._inputs.classes[place] = source
        return text

    def _note(self, place: str, text: str, why: str) -> None:
        self._inputs.notes.append(f"{place} is {text}: {why}")

    def _data(self, place: str, text: str) -> str:
        """Add a file or a folder of data, and the files that an XML scene names."""
        if "\n" in text or not text or not (self._folder / text).exists():
            return text
        path = (self._folder / text).resolve()
        if path.is_dir():
            if path.suffix == ".zarr":
                return self._add([path], path)
            return text
        files = [path]
        if path.suffix.lower() == ".xml":
            files += self._named_by(place, path)
        return self._add(files, path)

    def _named_by(self, place: str, scene: Path) -> list[Path]:
        """Return the files that a scene of Mitsuba names: meshes, pictures, included scenes."""
        found: list[Path] = []
        for text in _texts_of(scene):
            path = scene.parent / text
            if not path.is_file():
                continue
            if Path(text).is_absolute():
                self._note(place, text, f"{scene.name} names it by an absolute path")
            elif (path := path.resolve()) not in found:
                found.append(path)
                if path.suffix.lower() == ".xml":
                    found += self._named_by(place, path)
        return found

    def _add(self, paths: list[Path], named: Path) -> str:
        """Add files that belong together; return the path of one of them from a run's folder."""
        root = self._folder
        if not all(path.is_relative_to(root) for path in paths):
            root = Path(commonpath([path.parent for path in paths]))
            name = self._roots.setdefault(root, f"{OUTSIDE}/{len(self._roots) + 1}")
        else:
            name = ""
        for path in paths:
            inside = "/".join(part for part in (name, path.relative_to(root).as_posix()) if part)
            if path.is_dir():
                self._inputs.files |= dict(files_below(path, f"{FOLDER}/{inside}"))
            else:
                self._inputs.files[f"{FOLDER}/{inside}"] = path
        return "/".join(part for part in (name, named.relative_to(root).as_posix()) if part)

    def _code(self, file: Path) -> str:
        """Add a file of Python code, and the modules of the run's folder that it imports."""
        for name in _imports(file):
            self._local_module(name)
        return self._add([file.resolve()], file.resolve())

    def _module(self, place: str, text: str, name: str) -> None:
        """Add a module of the run's folder, or one found by Python that isn't installed."""
        package = name.partition(".")[0]
        if package == _OF_RFPIPE or self._local_module(name):
            return
        try:
            spec = find_spec(package)
        except (ImportError, ValueError):
            spec = None
        if spec is None or spec.origin is None:
            self._note(place, text, f"there is no module {package} here")
            return
        file = Path(spec.origin)
        if any(part in _INSTALLED for part in file.parts):
            self._note(place, text, f"{package} is an installed package; install it there, too")
            return
        home = file.parents[1] if file.name == "__init__.py" else file.parent
        self._add_module(home, package)

    def _local_module(self, name: str) -> bool:
        """Add a module or package of the run's folder; return False where it has none."""
        package = name.partition(".")[0]
        file, whole = self._folder / f"{package}.py", self._folder / package
        if not file.is_file() and not any(whole.glob("*.py")):
            return False
        self._add_module(self._folder, package)
        return True

    def _add_module(self, home: Path, package: str) -> None:
        """Add a module or package at the place where a run's folder has it, and its imports."""
        file, whole = home / f"{package}.py", home / package
        files = [file] if file.is_file() else [path for _, path in files_below(whole, "")]
        for path in files:
            name = f"{FOLDER}/{path.relative_to(home).as_posix()}"
            if name not in self._inputs.files:
                self._inputs.files[name] = path
                if path.suffix == ".py":
                    for each in _imports(path):
                        self._local_module(each)


def _texts_of(scene: Path) -> Iterator[str]:
    """Yield the texts of an XML file that may name files: values, and files that it includes."""
    try:
        elements = ElementTree.parse(scene).iter()
        for element in elements:
            for key in ("value", "filename"):
                if element.get(key):
                    yield str(element.get(key))
    except ElementTree.ParseError:
        return


def _imports(file: Path) -> Iterator[str]:
    """Yield the names of the modules that a file of Python code imports.

    Raises InputError where the file isn't Python.
    """
    try:
        tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None)
        where = f"{file}, line {line}" if line else f"{file}"
        raise InputError(
            f"{where}: isn't Python: {getattr(error, 'msg', error)}; no results were made with it. "
            "Mend the file and run again, or restore it as it was"
        ) from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
