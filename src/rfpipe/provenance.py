"""Fingerprints of settings and code, versions of what ran, and seeded random generators."""

from __future__ import annotations

import hashlib
import json
import platform
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.errors import InputError

__all__ = ["code_fingerprint", "fingerprint", "generator", "versions"]

_DIGEST_BYTES = 16  # blake2b-128: short enough for a manifest, no accidental collisions
_WORD = 2**32  # numpy's SeedSequence mixes 32-bit words
_RECORDED_PACKAGES = ("numba", "numpy", "rfpipe", "rustworkx", "scipy", "zarr")


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
    try:
        text = json.dumps(
            _plain(value), sort_keys=True, separators=(",", ":"), allow_nan=False
        ).encode()
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"fingerprint: {error}; settings must be finite numbers") from error
    return _digest(text)


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
        32 hexadecimal digits (blake2b-128) over the sorted names and contents of the files.

    Raises
    ------
    InputError
        When a name is no module with Python sources.
    """
    sources: dict[str, Path] = {}
    for name in module_names:
        sources |= _sources(name)
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for file_name, path in sorted(sources.items()):
        content = path.read_bytes()
        digest.update(f"{file_name}:{len(content)}:".encode())
        digest.update(content)
    return digest.hexdigest()


def versions() -> dict[str, str]:
    """Versions of Python, rfpipe and the packages whose arithmetic shapes a result.

    Returns
    -------
    dict
        Name to version, sorted by name; a package that isn't installed is left out.
    """
    found = {"python": platform.python_version()}
    for name in _RECORDED_PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
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
        return {
            "array": [value.dtype.str, list(value.shape), _digest(value.tobytes())],
        }
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
    spec = find_spec(top)  # finds a top-level name without importing it
    if spec is not None and spec.submodule_search_locations:
        for location in spec.submodule_search_locations:
            root = Path(location)
            target = root.joinpath(*rest)
            module = target.with_suffix(".py")
            files = sorted(target.rglob("*.py")) if target.is_dir() else []
            if module.is_file():
                files.append(module)
            if files:
                return {f"{top}/{path.relative_to(root).as_posix()}": path for path in files}
    raise InputError(f"{module_name!r} is no package of Python sources; expected rfpipe.<module>")
