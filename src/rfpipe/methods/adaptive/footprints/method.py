"""Former place of Footprints, until the shared environment is installed again; delete then."""

from importlib import import_module

Footprints = import_module("rfpipe.methods.footprints.method").Footprints
