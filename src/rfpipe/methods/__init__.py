"""Acquisition methods behind one protocol; each module is imported when its method is asked for."""

import importlib
from typing import Any

from rfpipe.errors import InputError
from rfpipe.methods.base import LevelImages, Method, Pack, Settings

__all__ = ["METHODS", "LevelImages", "Method", "Pack", "Settings", "get_method"]

METHODS = {
    "brute_force": ("rfpipe.methods.brute_force", "BruteForce"),
    "compressive": ("rfpipe.methods.rivals.compressive", "Compressive"),
    "dual": ("rfpipe.methods.dual", "Dual"),
    "hadamard": ("rfpipe.methods.rivals.hadamard", "Hadamard"),
    "low_rank": ("rfpipe.methods.rivals.low_rank", "LowRank"),
    "near_far": ("rfpipe.methods.near_far.method", "NearFar"),
    "symmetric": ("rfpipe.methods.symmetric.method", "Symmetric"),
}


def get_method(name: str) -> Method[Any]:
    """Return an acquisition method by its name.

    Raises
    ------
    InputError
        If there is no such method.
    """
    if name not in METHODS:
        raise InputError(f"method {name!r}: expected one of {', '.join(sorted(METHODS))}")
    module, cls = METHODS[name]
    method: Method[Any] = getattr(importlib.import_module(module), cls)()
    return method
