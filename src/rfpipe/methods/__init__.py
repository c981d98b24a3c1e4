"""Acquisition methods: each one a class that describes itself, found by its name."""

from rfpipe.methods.base import (
    LevelImages,
    Method,
    Options,
    Pack,
    get_method,
    method_names,
    options_of,
)

__all__ = ["LevelImages", "Method", "Options", "Pack", "get_method", "method_names", "options_of"]
