"""Mitsuba 3, which is an extra, with the variant that this machine can run.

Mitsuba's LLVM variants end the whole process where they find an LLVM that they can't use, so the
library's version is looked at before one is chosen.
"""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError

__all__ = ["VECTORISED", "load_mitsuba", "usable_llvm"]

VECTORISED = "llvm_ad_rgb"
_SCALAR = "scalar_rgb"
_VARIABLE = "DRJIT_LIBLLVM_PATH"
# Dr.Jit 1.5 refuses LLVM 14 and crashes with 15 and 16; it ran with 19 and 22.
_LEAST_LLVM = 19
_PLACES = (
    "/usr/lib/*-linux-gnu*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)
_VERSION = re.compile(r"libLLVM(?:-|\.so\.|\.)(\d+)")


@cache
def load_mitsuba() -> Any:
    """Return the module of Mitsuba 3, its variant chosen.

    The vectorised one where a usable LLVM is found, else the scalar one, with a warning. A variant
    that was chosen before stays.

    Raises
    ------
    InputError
        When Mitsuba isn't installed.
    """
    library = usable_llvm()
    if library is not None:
        os.environ[_VARIABLE] = str(library)
    try:
        import mitsuba
    except ImportError as error:
        raise InputError(
            "a scene of kind mitsuba needs Mitsuba 3, which isn't installed: "
            "python -m pip install 'rfpipe[mitsuba]'"
        ) from error
    if mitsuba.variant() is None:
        if library is None:
            warnings.warn(
                f"no LLVM of version {_LEAST_LLVM} or later was found (on Debian: apt install "
                "libllvm19), so that Mitsuba renders slowly, pattern by pattern",
                stacklevel=2,
            )
        mitsuba.set_variant(VECTORISED if library is not None else _SCALAR)
    return mitsuba


def usable_llvm() -> Path | None:
    """Return the newest LLVM library here that Mitsuba's LLVM variants run with, if any.

    The one that the environment variable DRJIT_LIBLLVM_PATH names goes first.
    """
    named = os.environ.get(_VARIABLE)
    if named and (_version(Path(named)) or 0) >= _LEAST_LLVM:
        return Path(named)
    found = (path for pattern in _PLACES for path in Path("/").glob(pattern.removeprefix("/")))
    return _newest(found) if sys.platform != "win32" else None


def _newest(libraries: Iterable[Path]) -> Path | None:
    """Return the library of the highest version of those that are recent enough."""
    versions = {path: _version(path) or 0 for path in libraries}
    usable = sorted((version, path) for path, version in versions.items() if version >= _LEAST_LLVM)
    return usable[-1][1] if usable else None


def _version(library: Path) -> int | None:
    """Return the major version of an LLVM library, by its name or that of what it links to."""
    for path in (library, library.resolve()):
        match = _VERSION.search(path.name)
        if match:
            return int(match.group(1))
    return None
