"""Mitsuba 3, an optional dependency, with a variant that runs on this machine.

Mitsuba's LLVM variants abort the process if the LLVM library is unusable, so its version is checked
before a variant is selected.
"""

from __future__ import annotations

import os
import re
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from rfpipe.installation import needing

_USER = "a scene of kind mitsuba"
_VARIABLE = "DRJIT_LIBLLVM_PATH"
# Dr.Jit 1.5 refuses LLVM 14 and crashes with 15 and 16; it ran with 19 and 22.
_MIN_LLVM = 19
_PATTERNS = (
    "/usr/lib/*-linux-gnu*/libLLVM*.so*",
    "/usr/lib/llvm-*/lib/libLLVM*.so*",
    "/usr/lib64/libLLVM*.so*",
    "/usr/lib64/llvm*/lib*/libLLVM*.so*",
    "/usr/local/lib/libLLVM*.so*",
    "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
    "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
)


@cache
def load_mitsuba() -> Any:
    """Import Mitsuba 3 and select its variant, unless one is selected already.

    The variant is vectorised if a usable LLVM is installed, else scalar, which is slow. Raises
    InputError when Mitsuba isn't installed.
    """
    library = usable_llvm()
    if library is not None:
        os.environ[_VARIABLE] = str(library)
    with needing("mitsuba", _USER):
        import mitsuba
    if mitsuba.variant() is None:
        mitsuba.set_variant("scalar_rgb" if library is None else "llvm_ad_rgb")
    return mitsuba


def missing_llvm(purpose: str) -> str | None:
    """Explain how to install LLVM for a purpose; None where a usable LLVM is installed.

    Mitsuba's scalar variant renders pictures, but can't trace the transport between pixels. A
    transport assembled from pictures has their noise: an asymmetry of 14 to 21 % with 64 paths per
    pixel, of 3 to 6 % with 1024.
    """
    if usable_llvm() is not None:
        return None
    return (
        f"{purpose} needs the library LLVM, version {_MIN_LLVM} or later, which isn't installed: "
        f"on Debian, apt-get install libllvm{_MIN_LLVM}; elsewhere set the environment variable "
        f"{_VARIABLE} to its file"
    )


def usable_llvm() -> Path | None:
    """Return the newest installed LLVM library that Mitsuba's LLVM variants support, or None.

    The environment variable DRJIT_LIBLLVM_PATH limits the search to one file.
    """
    configured = os.environ.get(_VARIABLE)
    installed = (path for pattern in _PATTERNS for path in Path("/").glob(pattern[1:]))
    versions = {path: _version(path) for path in ([Path(configured)] if configured else installed)}
    usable = sorted((version, path) for path, version in versions.items() if version >= _MIN_LLVM)
    return usable[-1][1] if usable else None


def variant_versions() -> dict[str, str]:
    """Versions of Mitsuba, Dr.Jit and LLVM on this machine; InputError without Mitsuba."""
    library = usable_llvm()
    with needing("mitsuba", _USER):
        packages = {name: metadata.version(name) for name in ("drjit", "mitsuba")}
    return packages | ({} if library is None else {"llvm": str(_version(library))})


def _version(library: Path) -> int:
    """Major version of an LLVM library, from its file name or its link's target; 0 if unknown."""
    for path in (library, library.resolve()):
        match = re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", path.name)
        if match:
            return int(match.group(1))
    return 0
