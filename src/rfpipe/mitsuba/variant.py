"""Mitsuba 3, which is an extra, with the variant that this machine can run.

Mitsuba's LLVM variants end the whole process where they find an LLVM that they can't use, so the
library's version is looked at before one is chosen.
"""

from __future__ import annotations

import os
import re
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, installing

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


@cache
def load_mitsuba() -> Any:
    """Return the module of Mitsuba 3, its variant chosen.

    The vectorised one where a usable LLVM is found, else the scalar one, which is slow. A variant
    that was chosen before stays. Raises InputError when Mitsuba isn't installed.
    """
    library = usable_llvm()
    if library is not None:
        os.environ[_VARIABLE] = str(library)
    try:
        import mitsuba
    except ImportError as error:
        raise InputError(
            "a scene of kind mitsuba needs Mitsuba 3, which isn't installed: "
            f"{installing('mitsuba')}"
        ) from error
    if mitsuba.variant() is None:
        mitsuba.set_variant("scalar_rgb" if library is None else "llvm_ad_rgb")
    return mitsuba


def lacking_llvm(what: str) -> str | None:
    """Return a sentence on what needs LLVM and how to get it, None where LLVM can be used here.

    Mitsuba's scalar variant can render pictures, but not trace the transport between pixels. That
    of pictures has their noise: an asymmetry of 14 to 21 % by 64 paths a pixel, of 3 to 6 % by 16
    times as many.
    """
    if usable_llvm() is not None:
        return None
    return (
        f"{what} needs the library LLVM, version {_LEAST_LLVM} or later, which isn't here: on "
        f"Debian, apt-get install libllvm{_LEAST_LLVM}; elsewhere name its file in the "
        f"environment variable {_VARIABLE}"
    )


def usable_llvm() -> Path | None:
    """Return the newest LLVM library here that Mitsuba's LLVM variants run with, or None.

    Where the environment variable DRJIT_LIBLLVM_PATH names one, it is that or none.
    """
    named = os.environ.get(_VARIABLE)
    places = (path for pattern in _PLACES for path in Path("/").glob(pattern[1:]))
    versions = {path: _version(path) for path in ([Path(named)] if named else places)}
    usable = sorted((version, path) for path, version in versions.items() if version >= _LEAST_LLVM)
    return usable[-1][1] if usable else None


def variant_versions() -> dict[str, str]:
    """Return the versions of Mitsuba, Dr.Jit and LLVM that trace here."""
    library = usable_llvm()
    packages = {name: metadata.version(name) for name in ("drjit", "mitsuba")}
    return packages | ({} if library is None else {"llvm": str(_version(library))})


def _version(library: Path) -> int:
    """Major version of an LLVM library, by its name or that of its link's target; 0 if unknown."""
    for path in (library, library.resolve()):
        match = re.search(r"libLLVM(?:-|\.so\.|\.)(\d+)", path.name)
        if match:
            return int(match.group(1))
    return 0
