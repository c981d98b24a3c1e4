"""Fingerprints of settings and code, versions of what ran, and seeded random generators."""

from __future__ import annotations

import hashlib
import json
import platform
from contextlib import suppress
from functools import cache
from importlib import metadata
from pathlib import Path
from types import CodeType
from typing import Any

import numpy as np

from rfpipe.errors import InputError
from rfpipe.version import __version__

_DIGEST_BYTES = 16  # blake2b-128: short enough for a manifest, no accidental collisions
_WORD = 2**32  # numpy's SeedSequence mixes 32-bit words
_PACKAGE = Path(__file__).parent
_RECORDED_PACKAGES = ("numba", "numpy", "rustworkx", "scipy", "zarr")

# Of rfpipe: what shows results, serves them or runs jobs, and shapes none.
_SHAPES_NOTHING = (
    "calibration/", "cli/", "export/", "fitting/", "publish/", "report/", "server/",
    "stages/evaluate.py", "stages/jobs/", "stages/check", "testing/", "viewer/",
)  # fmt: skip


def fingerprint(value: object) -> str:
    """Return the digest of a value, the same on every machine and in every process.

    Parameters
    ----------
    value
        Plain data (None, bool, int, finite float, str; lists, tuples and dicts with string
        keys), pydantic models, NumPy scalars and arrays, nested as you like. Lists and tuples
        count as equal; the order of a dict's keys doesn't matter. An array is known by its
        dtype, shape and bytes. InputError for anything else.

    Returns
    -------
    str
        32 hexadecimal digits (blake2b-128).
    """
    plain = _plain(value)
    try:
        text = json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except ValueError as error:
        raise InputError(f"fingerprint: {error}; settings must be finite numbers") from error
    return _digest(text.encode())


@cache
def code_digest(*own: Path, pages: bool = False) -> str:
    """Return the digest of the code that shapes results: rfpipe's and files of a user's own.

    Comments, what docstrings say, assertions and layout don't count.

    Parameters
    ----------
    own : Path
        Python files beside rfpipe's, such as that of a user's method. What they import doesn't
        count.
    pages : bool
        Whether the code counts, too, that shows results, as on a report's page.

    Returns
    -------
    str
        32 hexadecimal digits (blake2b-128), the same in all processes of one version of Python.

    Raises
    ------
    InputError
        When a file can't be read or isn't Python.
    """
    sources = {
        path.relative_to(_PACKAGE).as_posix(): path
        for path in _PACKAGE.rglob("*.py")
        if pages or not path.relative_to(_PACKAGE).as_posix().startswith(_SHAPES_NOTHING)
    }
    sources |= {f"{number} {path.name}": path for number, path in enumerate(own)}
    return fingerprint({name: _compiled(path) for name, path in sources.items()})


@cache
def _compiled(path: Path) -> list[Any]:
    """Return what Python makes of a source, without its docstrings and the lines' numbers."""
    try:
        return _parts_of(compile(path.read_bytes(), "", "exec", optimize=2, dont_inherit=True))
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: not readable as Python: {error}") from error


def _parts_of(code: CodeType) -> list[Any]:
    constants = [
        _parts_of(value) if isinstance(value, CodeType) else _text_of(value)
        for value in code.co_consts
    ]
    names = [code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars]
    counts = [code.co_argcount, code.co_kwonlyargcount, code.co_posonlyargcount, code.co_flags]
    return [*names, *counts, code.co_code.hex(), code.co_exceptiontable.hex(), constants]


def _text_of(constant: object) -> str:
    """Return a constant as text; a set's order differs from process to process."""
    return repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant)


def versions() -> dict[str, str]:
    """Return the versions of Python, rfpipe and the packages whose arithmetic shapes a result.

    By their names, sorted; a package that isn't installed is left out.
    """
    return dict(_versions())


@cache  # a package's version is looked for on the disk, and every manifest names it
def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "rfpipe": __version__}
    for name in _RECORDED_PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return dict(sorted(found.items()))


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return a Philox generator that depends on a seed and a key alone.

    Work in any order and on any number of workers draws the same numbers.

    Parameters
    ----------
    seed
        The run's seed, not negative.
    key
        Where the numbers are used, such as (level, pattern index, exposure index): integers in
        [0, 2**32). Keys of different lengths are different keys, also when one is the other
        with zeros appended.

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
