"""Fingerprints of settings and code, versions of what ran, and seeded random generators."""

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

# Of rfpipe: what shows results, serves them or runs jobs, and shapes none.
_SHAPES_NOTHING = (
    "calibration/", "cli/", "devices/", "export/", "fitting/", "publishing/", "report/", "server/",
    "jobs/", "stages/evaluate.py", "storage/checking.py", "testing/", "viewer/",
)  # fmt: skip


def workflow_folder() -> Path:
    """Return the folder of the Snakefile: of the clone that rfpipe runs from, or in the package."""
    installed = _PACKAGE / "_workflow"
    return installed if installed.is_dir() else _PACKAGE.parents[1]


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
    return _digest(_json_text(value).encode())


def plain_data(value: object) -> Any:
    """Return a value as JSON reads it again: tuples as lists, arrays as their digests.

    Takes the values, and raises the errors, that `fingerprint` does.
    """
    return json.loads(_json_text(value))


def _json_text(value: object) -> str:
    try:
        return json.dumps(
            value, default=_plain, sort_keys=True, separators=(",", ":"), allow_nan=False
        )
    except (ValueError, TypeError) as error:
        raise InputError(
            f"fingerprint: {error}; pass finite numbers, strings, arrays, lists, dicts or pydantic "
            "models"
        ) from error


@cache
def code_digest(*own: Path, pages: bool = False) -> str:
    """Return the digest of the code that shapes results: rfpipe's and files of a user's own.

    Comments, what docstrings say and layout don't count.

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
    return fingerprint({name: _parsed(path) for name, path in sources.items()})


def source_digest(*files: Path) -> str:
    """Return the digest of Python files; comments, what docstrings say and layout don't count.

    Raises
    ------
    InputError
        When a file can't be read or isn't Python.
    """
    return fingerprint([_parsed(path) for path in files])


@cache
def _parsed(path: Path) -> str:
    """Return the syntax tree of a source, without its docstrings and the lines' numbers."""
    try:
        tree = ast.parse(path.read_bytes())
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{path}: not readable as Python: {error}") from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            node.value.value = ""
    return ast.dump(tree)


@cache  # a package's version is looked for on the disk, and every manifest names it
def versions() -> dict[str, str]:
    """Return the versions of Python, rfpipe and the packages whose arithmetic shapes a result."""
    releases = {name: metadata.version(name) for name in _RECORDED_PACKAGES}
    releases |= {"python": platform.python_version(), "rfpipe": __version__}
    return dict(sorted(releases.items()))


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

    """
    # The key goes in as spawn key: plain entropy [seed, *key] is padded with zeros, so that
    # (seed,) and (seed, 0) would draw the same numbers.
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))


def _digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).hexdigest()


def _plain(value: Any) -> Any:
    """Return what JSON lacks as JSON data; arrays become a digest."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and not value.dtype.hasobject:
        return {"array": [value.dtype.str, list(value.shape), _digest(value.tobytes())]}
    if hasattr(value, "model_dump"):  # a pydantic model
        return value.model_dump(mode="json")
    raise TypeError(f"a {type(value).__name__} isn't plain data")
