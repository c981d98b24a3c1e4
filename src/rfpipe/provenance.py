"""Fingerprints of settings and code, versions of packages, and seeded random generators."""

from __future__ import annotations

import ast
import hashlib
import json
import platform
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from rfpipe.errors import InputError
from rfpipe.version import __version__

_DIGEST_BYTES = 16  # blake2b-128: short enough for a manifest, no accidental collisions
_PACKAGE = Path(__file__).parent
_RECORDED_PACKAGES = ("numba", "numpy", "rustworkx", "scipy", "zarr")

_WITHOUT_EFFECT_ON_RESULTS = (
    "calibration/", "cli/", "devices/", "export/", "fitting/", "publishing/", "report/", "server/",
    "jobs/", "stages/evaluate.py", "storage/checking.py", "testing/", "viewer/",
)  # fmt: skip
"""Code of rfpipe that displays or serves results or runs jobs, without changing results."""


def fingerprint(value: object) -> str:
    """Return the digest of a value, the same on every machine and in every process.

    Parameters
    ----------
    value
        Plain data (None, bool, int, finite float, str; lists, tuples and dicts with string
        keys), pydantic models, NumPy scalars and arrays, in any nesting. Lists and tuples count
        as equal; the order of a dict's keys doesn't matter. An array contributes its dtype, shape
        and bytes.

    Returns
    -------
    str
        32 hexadecimal digits (blake2b-128).

    Raises
    ------
    InputError
        When `value` contains another type, NaN or infinity.
    """
    return _digest(_json_text(value).encode())


def plain_data(value: object) -> Any:
    """Return a value after a round trip through JSON: tuples as lists, arrays as digests.

    It takes the same values and raises the same errors as `fingerprint`.
    """
    return json.loads(_json_text(value))


def _json_text(value: object) -> str:
    try:
        return json.dumps(
            value, default=_plain, sort_keys=True, separators=(",", ":"), allow_nan=False
        )
    except (ValueError, TypeError) as error:
        raise InputError(
            f"value has no fingerprint: {error}",
            remedy="pass finite numbers, strings, arrays, lists, dicts or pydantic models",
        ) from error


@cache
def code_digest(*user_files: Path, pages: bool = False) -> str:
    """Return the digest of the code that determines results: rfpipe's and a user's files.

    Comments, docstrings and layout don't contribute.

    Parameters
    ----------
    *user_files : Path
        Python files outside rfpipe, such as the file of a user's method. Modules that they import
        don't contribute.
    pages : bool
        Include the code that displays results, as on a report's page.

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
        if pages or not path.relative_to(_PACKAGE).as_posix().startswith(_WITHOUT_EFFECT_ON_RESULTS)
    }
    sources |= {f"{number} {path.name}": path for number, path in enumerate(user_files)}
    return fingerprint({name: _parsed(path) for name, path in sources.items()})


def source_digest(*files: Path) -> str:
    """Return the digest of Python files without comments, docstrings and layout.

    Raises
    ------
    InputError
        When a file can't be read or isn't Python.
    """
    return fingerprint([_parsed(path) for path in files])


@cache
def _parsed(path: Path) -> str:
    """Return the syntax tree of a source file, without docstrings and line numbers."""
    try:
        tree = ast.parse(path.read_bytes())
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(
            f"file isn't readable as Python: {error}", place=path, remedy="correct the file"
        ) from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = ""
    return ast.dump(tree)


@cache  # every manifest contains the versions, which are read from the disk
def versions() -> dict[str, str]:
    """Return the versions of Python, rfpipe and the packages that influence results."""
    releases = {name: metadata.version(name) for name in _RECORDED_PACKAGES}
    releases |= {"python": platform.python_version(), "rfpipe": __version__}
    return dict(sorted(releases.items()))


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return a Philox generator that depends only on a seed and a key.

    It makes random numbers independent of the order of work and the number of workers.

    Parameters
    ----------
    seed
        Seed of the run, not negative.
    *key
        Use of the numbers, such as (level, pattern index, exposure index): integers in
        [0, 2**32). Keys of different lengths differ, even if they differ only by appended zeros.
    """
    # as entropy [seed, *key], padded with zeros, (seed,) and (seed, 0) would draw the same numbers
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).hexdigest()


def _plain(value: Any) -> Any:
    """Convert NumPy scalars, arrays and pydantic models to JSON data; arrays become a digest."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return {"array": [value.dtype.str, list(value.shape), _digest(value.tobytes())]}
    if hasattr(value, "model_dump"):  # a pydantic model
        return value.model_dump(mode="json")
    raise TypeError(f"a {type(value).__name__} isn't plain data")
