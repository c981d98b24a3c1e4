"""Former place of Auto, until the shared environment is installed again; delete then."""

from importlib import import_module

Auto = import_module("rfpipe.methods.auto").Auto
