"""What describes itself: methods, scenes and devices, found by name or by a path of the user's own.

A name is that of an entry point in one of rfpipe's groups, of rfpipe or of another package. A path
is ``module:Class``, the module found as Python finds it or in the folder where rfpipe runs, or
``file.py:Class``, the file relative to that folder.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cache
from hashlib import sha256
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from rfpipe.errors import InputError, RfpipeError

METHODS = "rfpipe.methods"
"""The group of acquisition methods."""

PROJECTORS, CAMERAS, RIGS = "rfpipe.projectors", "rfpipe.cameras", "rfpipe.rigs"
"""The groups of devices' drivers, and of rigs as a whole."""

SCENES = "rfpipe.scenes"
"""The group of kinds of scenes."""


@cache
def _installed() -> dict[str, dict[str, str]]:
    """Where the names of each group lead; read once, since every package installed is asked."""
    entries = entry_points()
    # of two packages with the same name, the first on the path has it
    return {
        group: {entry.name: entry.value for entry in reversed(tuple(entries.select(group=group)))}
        for group in (METHODS, PROJECTORS, CAMERAS, RIGS, SCENES)
    }


def names(group: str) -> tuple[str, ...]:
    """Return the names in a group of entry points, in alphabetical order."""
    return tuple(sorted(_installed()[group]))


def path_of(group: str, name: str) -> str:
    """Return where a name of a group leads, ``module:Class``; a path leads to itself.

    Raises
    ------
    InputError
        When the group has no such name.
    """
    if ":" in name:
        return name
    if name not in names(group):
        choices = f"one of {', '.join(names(group))}, or " if names(group) else ""
        close = get_close_matches(name, names(group), n=1)
        expected = f"did you mean {close[0]}? Expected" if close else "expected"
        raise InputError(
            f"{name!r} is unknown; {expected} {choices}a class of your own as module:Class or "
            "file.py:Class"
        )
    return _installed()[group][name]


def sources_of(group: str, name: str) -> tuple[Path, ...]:
    """Return the files behind a name or path that rfpipe's own digest of code doesn't count.

    None for rfpipe itself, else the file of the class.

    Raises
    ------
    InputError
        When there is no such name, module or file.
    """
    module = path_of(group, name).rpartition(":")[0]
    package = module.partition(".")[0]
    if package == "rfpipe":
        return ()
    file = (_file(module) if module.endswith(".py") else _module(module)).__file__
    return () if file is None else (Path(file),)


def is_of_rfpipe(group: str, name: str) -> bool:
    """Test whether a name leads to a class of rfpipe, not to a user's code.

    Raises
    ------
    InputError
        When the group has no such name.
    """
    module = path_of(group, name).rpartition(":")[0]
    package = module.partition(".")[0]
    return not module.endswith(".py") and package == "rfpipe"


def find(group: str, name: str) -> Any:
    """Return what a name or path of a group stands for.

    Raises
    ------
    InputError
        When there is no such name, module, file or class, or a user's code can't be imported:
        says which, and what to do.
    """
    module, _, attribute = path_of(group, name).rpartition(":")
    try:
        namespace = _file(module) if module.endswith(".py") else _module(module)
        return getattr(namespace, attribute)
    except AttributeError as error:
        raise InputError(f"{name!r}: {module} has no {attribute!r}; expected a class in it") from (
            error
        )


def _module(name: str) -> ModuleType:
    module = _imported(name)
    here = str(Path.cwd())
    if module is None and here not in sys.path:
        sys.path.insert(0, here)
        module = _imported(name)
    if module is None:
        raise _missing(name)
    return module


def _imported(name: str) -> ModuleType | None:
    """Import a module; None where Python has none of this name."""
    package = name.partition(".")[0]
    if package == "rfpipe":
        return _if_there(name)
    with _errors_of_user_code(f"module {name!r}"):
        return _if_there(name)


def _if_there(name: str) -> ModuleType | None:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise  # the module is there, and lacks one that it needs
        return None


@contextmanager
def _errors_of_user_code(what: str) -> Iterator[None]:
    """Turn an error of Python code at its import into an InputError with file and line."""
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
        remedy = "mend the code"
        if isinstance(error, ModuleNotFoundError):
            remedy = f"install {error.name}, or mend the import"
        raise InputError(
            f"{what} can't be imported: {file}, line {line}: {type(error).__name__}: {reason}; "
            f"{remedy}, then run again"
        ) from error


def _missing(name: str) -> InputError:
    return InputError(
        f"module {name!r} is not to be found; install it, put {name.partition('.')[0]}.py into "
        f"{Path.cwd()}, or give the path of its file, as in folder/file.py:Class"
    )


def _file(path: str) -> ModuleType:
    file = Path(path).resolve()
    name = f"{file.stem}_{sha256(str(file).encode()).hexdigest()[:12]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = spec_from_file_location(name, file)
    if spec is None or spec.loader is None or not file.is_file():
        raise InputError(f"there is no file {path} in {Path.cwd()}; expected Python code")
    module = module_from_spec(spec)
    sys.modules[name] = module
    try:
        with _errors_of_user_code(path):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
