"""Fingerprints of settings and code, versions of what ran, and seeded random generators."""

from __future__ import annotations

import hashlib
import json
import platform
import re
import sys
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from functools import cache
from importlib import metadata
from importlib.machinery import PathFinder
from importlib.util import find_spec
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.errors import InputError

__all__ = [
    "code_fingerprint",
    "fingerprint",
    "generator",
    "import_fingerprint",
    "imported_sources",
    "versions",
]

_DIGEST_BYTES = 16  # blake2b-128: short enough for a manifest, no accidental collisions
_WORD = 2**32  # numpy's SeedSequence mixes 32-bit words
_RECORDED_PACKAGES = ("numba", "numpy", "rfpipe", "rustworkx", "scipy", "zarr")

# Imports begin a line, as formatters leave them: parsing all sources would take seconds.
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]+(\([^)]*\)|[^\n#]+)|import[ \t]+([^\n#]+))",
    re.MULTILINE,
)
_FOR_TYPES_ALONE = re.compile(
    r"^([ \t]*)if (?:\w+\.)?TYPE_CHECKING:[^\n]*\n(?:\1[ \t]+[^\n]*\n|[ \t]*\n)+", re.MULTILINE
)
_IMPORTS_BY_NAME = re.compile(r"\bimport_module\(")  # which this line is no case of
_DOTTED_NAME = re.compile(r"""["'](\w+(?:\.\w+)+)["']""")


def fingerprint(value: object) -> str:
    """Digest of a value, equal for equal values on every machine and in every process.

    Parameters
    ----------
    value
        Plain data (None, bool, int, finite float, str; lists, tuples and dicts with string
        keys), pydantic models, NumPy scalars and arrays, nested as you like. Lists and tuples
        count as equal; the order of a dict's keys doesn't matter. An array is known by its
        dtype, shape and bytes.

    Returns
    -------
    str
        32 hexadecimal digits (blake2b-128).

    Raises
    ------
    InputError
        For anything else, and for NaN or infinity outside an array.
    """
    plain = _plain(value)
    try:
        text = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise InputError(f"fingerprint: {error}; settings must be finite numbers") from error
    return _digest(text.encode())


def code_fingerprint(*module_names: str) -> str:
    """Digest of the Python sources of modules or packages, without importing them.

    Parameters
    ----------
    module_names
        Dotted names, such as ``"rfpipe.methods"``. A package counts with all it contains.
        The order of the names doesn't matter.

    Returns
    -------
    str
        32 hexadecimal digits (blake2b-128) over the names and contents of the files.

    Raises
    ------
    InputError
        When a name is no module with Python sources.
    """
    sources: dict[str, Path] = {}
    for name in module_names:
        sources |= _sources(name)
    return fingerprint({name: _digest(path.read_bytes()) for name, path in sources.items()})


def import_fingerprint(
    *roots: str, choosing: Collection[str] = (), without: Collection[str] = ()
) -> str:
    """Digest of the Python sources of modules and of all that they import.

    Parameters and errors are those of `imported_sources`.

    Returns
    -------
    str
        32 hexadecimal digits (blake2b-128); the order of the roots doesn't matter.
    """
    sources = imported_sources(*roots, choosing=choosing, without=without)
    return fingerprint({name: _scanned(path)[0] for name, path in sources.items()})


def imported_sources(
    *roots: str, choosing: Collection[str] = (), without: Collection[str] = ()
) -> dict[str, Path]:
    """Find the sources of modules and of all that they import, without importing any.

    Imports inside functions count, those for type checkers alone don't. Followed are the modules
    of rfpipe and of the roots' own packages. A module that calls ``import_module`` reaches each
    module that one of its strings names.

    Parameters
    ----------
    roots
        Dotted names of modules, or paths of Python files (``*.py``).
    choosing
        Modules of which what they import by name isn't followed, since one of many is chosen: a
        registry. Give the choice as a root.
    without
        Modules, or packages with all they contain, that neither count nor are followed.

    Returns
    -------
    dict of str to Path
        Python files by dotted name, sorted; those of files given by their path by file name.

    Raises
    ------
    InputError
        When a root is no module with Python sources.
    """
    found: dict[str, Path] = {}
    without = frozenset(without)
    to_follow: list[tuple[str, Path]] = []
    for root in roots:
        path = Path(root) if root.endswith(".py") else _module_file(root)
        if path is None or not path.is_file():
            raise InputError(f"{root!r} is no module with Python sources; expected rfpipe.<module>")
        to_follow.append((path.name if root.endswith(".py") else root, path))
    followed = {"rfpipe", *(root.partition(".")[0] for root in roots if not root.endswith(".py"))}
    search_path = tuple(sys.path)
    while to_follow:
        name, path = to_follow.pop()
        if name in found or not without.isdisjoint(_prefixes(name)):
            continue
        found[name] = path
        by_import, by_name = _reached(name, path, frozenset(followed), search_path, *_status(path))
        to_follow += by_import
        to_follow += () if name in choosing else by_name
    return dict(sorted(found.items()))


def versions() -> dict[str, str]:
    """Versions of Python, rfpipe and the packages whose arithmetic shapes a result.

    Returns
    -------
    dict
        Name to version, sorted by name; a package that isn't installed is left out.
    """
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    # kept, since a package's version is looked for on the disk, and every manifest names it
    found = {"python": platform.python_version()}
    for name in _RECORDED_PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return dict(sorted(found.items()))


def generator(seed: int, *key: int) -> np.random.Generator:
    """Random generator that depends on a seed and a key alone.

    The numbers of one key don't depend on which keys were used before, so that work in any order
    and on any number of workers draws the same ones.

    Parameters
    ----------
    seed
        The run's seed, not negative.
    key
        Where the numbers are used, such as (level, pattern index, exposure index): integers in
        [0, 2**32). Keys of different lengths are different keys, also when one is the other
        with zeros appended.

    Returns
    -------
    numpy.random.Generator
        A Philox generator.

    Raises
    ------
    InputError
        When the seed is negative or a part of the key is out of range.
    """
    if seed < 0:
        raise InputError(f"seed is {seed}; expected an integer of at least 0")
    for part in key:
        if not 0 <= part < _WORD:
            raise InputError(f"key {key} holds {part}; expected integers from 0 to 2**32 - 1")
    # The key goes in as spawn key: plain entropy [seed, *key] is padded with zeros, so that
    # (seed,) and (seed, 0) would draw the same numbers.
    sequence = np.random.SeedSequence(seed, spawn_key=key)
    return np.random.Generator(np.random.Philox(sequence))


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).hexdigest()


def _plain(value: object) -> Any:
    """JSON data of a value; arrays become a digest."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise InputError(f"fingerprint: an array of dtype {value.dtype} has no stable bytes")
        return {"array": [value.dtype.str, list(value.shape), _digest(value.tobytes())]}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        for name in value:
            if not isinstance(name, str):
                raise InputError(f"fingerprint: the key {name!r} of a dict must be a string")
        return {name: _plain(item) for name, item in value.items()}
    dump = getattr(value, "model_dump", None)  # a pydantic model
    if callable(dump):
        return dump(mode="json")
    raise InputError(
        f"fingerprint: a {type(value).__name__} isn't plain data; pass numbers, strings, arrays, "
        "lists, dicts or pydantic models"
    )


def _sources(module_name: str) -> dict[str, Path]:
    """Python files of a module or package, by their name below the top-level package."""
    top, *rest = module_name.split(".")
    folders, _ = _top_level(top, tuple(sys.path))
    for root in folders:
        target = root.joinpath(*rest)
        files = [*target.rglob("*.py"), *target.parent.glob(f"{target.name}.py")]
        if files:
            return {f"{top}/{path.relative_to(root).as_posix()}": path for path in files}
    raise InputError(f"{module_name!r} is no package of Python sources; expected rfpipe.<module>")


def _scanned(path: Path) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Digest of a source, the names it imports and those it may import by name."""
    return _scan(path, *_status(path))


def _status(path: Path) -> tuple[int, int]:
    """Tell a file from what it was before an edit."""
    status = path.stat()
    return status.st_mtime_ns, status.st_size


_Sources = tuple[tuple[str, Path], ...]


@cache
def _reached(
    name: str, path: Path, followed: frozenset[str], _path: tuple[str, ...], *status: int
) -> tuple[_Sources, _Sources]:
    """Find the sources that a module imports, its own packages among them, and those by name."""
    _, imports, by_name = _scan(path, *status)
    package = name if path.name == "__init__.py" else name.rpartition(".")[0]

    def sources(names: Iterable[str]) -> _Sources:
        parts = dict.fromkeys(part for full in names for part in _prefixes(full))
        found = ((part, _module_file(part)) for part in parts if part.partition(".")[0] in followed)
        return tuple((part, source) for part, source in found if source)

    absolute = (_absolute(imported, package) for imported in imports)
    return sources((name, *absolute)), sources(by_name)


@cache
def _scan(path: Path, *_status: int) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    content = path.read_bytes()
    text = content.decode(errors="replace")
    by_name = tuple(_DOTTED_NAME.findall(text)) if _IMPORTS_BY_NAME.search(text) else ()
    text = _FOR_TYPES_ALONE.sub("", text.replace("\\\n", " "))
    return _digest(content), tuple(_imports(text)), by_name


def _imports(text: str) -> Iterator[str]:
    """Yield what a source imports, a name imported from a module as if it were a module itself."""
    for home, names, modules in _IMPORT.findall(text):
        for item in re.sub(r"#.*|[()]", "", names or modules).split(","):
            name = item.split()[0] if item.strip() else ""
            if name:
                yield (home if home.endswith(".") else f"{home}.") + name if home else name


def _absolute(name: str, package: str) -> str:
    """Name of what a module of a package imports, maybe relative to it."""
    stripped = name.lstrip(".")
    up = len(name) - len(stripped)
    return ".".join([*package.split(".")[: 1 - up or None], stripped]) if up else name


def _prefixes(name: str) -> Iterator[str]:
    """Return a module's packages, outermost first, and the module."""
    return accumulate(name.split("."), "{}.{}".format)


def _module_file(name: str) -> Path | None:
    """Python file of a module or package, None where there is none."""
    top, _, rest = name.partition(".")
    return _file_in(*_top_level(top, tuple(sys.path)), rest)


@cache
def _top_level(name: str, _path: tuple[str, ...]) -> tuple[tuple[Path, ...], Path | None]:
    """Folders of a top-level package, or the file of a module, found without importing it."""
    # also where rfpipe runs, in which a user's own modules may lie
    spec = find_spec(name) or PathFinder.find_spec(name, [str(Path.cwd())])
    if spec is None:
        return (), None
    if spec.submodule_search_locations is not None:
        return tuple(map(Path, spec.submodule_search_locations)), None
    return (), Path(spec.origin) if spec.has_location and spec.origin else None


@cache
def _file_in(folders: tuple[Path, ...], module: Path | None, name: str) -> Path | None:
    if module is not None:
        return module if not name and module.suffix == ".py" else None
    for folder in folders:
        target = folder.joinpath(*name.split("."))
        for path in (target.with_suffix(".py") if name else None, target / "__init__.py"):
            if path is not None and path.is_file():
                return path
    return None
