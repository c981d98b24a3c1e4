"""Acquisition methods, see `rfpipe.methods.base`."""

from rfpipe.methods.base import (
    LevelImages,
    Method,
    MethodDescription,
    Options,
    StateArrays,
    get_method,
    method_names,
    options_of,
)

__all__ = [
    "LevelImages",
    "Method",
    "MethodDescription",
    "Options",
    "StateArrays",
    "get_method",
    "method_names",
    "options_of",
]
