"""Plug-ins: methods, scenes and devices, by the name of an entry point or by the path of a class.

Names belong to entry points of rfpipe or of an installed package, in one of the groups below. A
path is ``module:Class``, with a module that Python can import or that is in the current folder, or
``file.py:Class``, with a file relative to the current folder.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from rfpipe.errors import InputError, RfpipeError
from rfpipe.text import did_you_mean

METHODS = "rfpipe.methods"
"""Group of acquisition methods."""

PROJECTORS, CAMERAS, RIGS = "rfpipe.projectors", "rfpipe.cameras", "rfpipe.rigs"
"""Groups of drivers for projectors, cameras and complete rigs."""

SCENES = "rfpipe.scenes"
"""Group of kinds of scenes."""


@cache
def _installed() -> dict[str, dict[str, str]]:
    """Path of each entry point, by group and name; cached, since this reads all packages."""
    entries = entry_points()
    # if two packages define a name, the first on the path wins
    return {
        group: {entry.name: entry.value for entry in reversed(tuple(entries.select(group=group)))}
        for group in (METHODS, PROJECTORS, CAMERAS, RIGS, SCENES)
    }


def names(group: str) -> tuple[str, ...]:
    """Return the names in a group of entry points, in alphabetical order."""
    return tuple(sorted(_installed()[group]))


def path_of(group: str, name: str) -> str:
    """Return the path ``module:Class`` of a name in a group; a path is returned unchanged.

    Raises
    ------
    InputError
        When the group has no such name.
    """
    if ":" in name:
        return name
    if name not in names(group):
        choices = f"one of {', '.join(names(group))}, or " if names(group) else ""
        suggestion = did_you_mean(name, names(group))
        expected = f"{suggestion} Expected" if suggestion else "expected"
        raise InputError(
            f"{name!r} is unknown",
            remedy=f"{expected} {choices}a class of your own as module:Class or file.py:Class",
        )
    return _installed()[group][name]


def sources_of(group: str, name: str) -> tuple[Path, ...]:
    """Return the source files of a plug-in that `rfpipe.provenance.code_digest` doesn't cover.

    There are none for a class of rfpipe, else the file of the class.

    Raises
    ------
    InputError
        When the name, module or file doesn't exist.
    """
    if is_of_rfpipe(group, name):
        return ()
    module = path_of(group, name).rpartition(":")[0]
    file = (_file(module) if module.endswith(".py") else _module(module)).__file__
    return () if file is None else (Path(file),)


def is_of_rfpipe(group: str, name: str) -> bool:
    """Return True if a name or path refers to a class of rfpipe, not to a user's code.

    Raises
    ------
    InputError
        When the group has no such name.
    """
    module = path_of(group, name).rpartition(":")[0]
    package = module.partition(".")[0]
    return not module.endswith(".py") and package == "rfpipe"


def find(group: str, name: str) -> Any:
    """Import the class of a name or path.

    Raises
    ------
    InputError
        When the name, module, file or class doesn't exist, or a user's code can't be imported.
    """
    module, _, attribute = path_of(group, name).rpartition(":")
    try:
        namespace = _file(module) if module.endswith(".py") else _module(module)
        return getattr(namespace, attribute)
    except AttributeError as error:
        raise InputError(
            f"{module} has no {attribute!r}", place=name, remedy="name a class of this module"
        ) from error


def _module(name: str) -> ModuleType:
    module = _imported(name)
    folder = str(Path.cwd())
    if module is None and folder not in sys.path:
        sys.path.insert(0, folder)
        module = _imported(name)
    if module is None:
        raise _missing(name)
    return module


def _imported(name: str) -> ModuleType | None:
    """Import a module; None if Python finds no module of this name."""
    package = name.partition(".")[0]
    if package == "rfpipe":
        return _import_or_none(name)
    with _errors_of_user_code(f"module {name!r}"):
        return _import_or_none(name)


def _import_or_none(name: str) -> ModuleType | None:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise  # the module exists, but a module that it imports doesn't
        return None


@contextmanager
def _errors_of_user_code(source: str) -> Iterator[None]:
    """Turn an exception at the import of a user's code into an InputError with file and line."""
    try:
        yield
    except RfpipeError:
        raise
    except Exception as error:
        if isinstance(error, SyntaxError):
            file, line, reason = error.filename, error.lineno, error.msg
        else:
            frames = traceback.extract_tb(error.__traceback__)
            last = [frame for frame in frames if not frame.filename.startswith("<")][-1]
            file, line, reason = last.filename, last.lineno, str(error)
        correction = "correct the code"
        if isinstance(error, ModuleNotFoundError):
            correction = f"install {error.name}, or correct the import"
        raise InputError(
            f"{source} can't be imported: {type(error).__name__}: {reason}",
            place=f"{file}, line {line}",
            remedy=f"{correction}, then run again",
        ) from error


def _missing(name: str) -> InputError:
    return InputError(
        f"there is no module {name!r}",
        remedy=f"install it, put {name.partition('.')[0]}.py into {Path.cwd()}, or give the path "
        "of its file, as in folder/file.py:Class",
    )


def _file(path: str) -> ModuleType:
    file = Path(path).resolve()
    name = f"{file.stem}_{sha256(str(file).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InputError(
            f"there is no file {path} in {Path.cwd()}", remedy="give the path of a Python file"
        )
    module = module_from_spec(spec)
    sys.modules[name] = module
    try:
        with _errors_of_user_code(path):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
