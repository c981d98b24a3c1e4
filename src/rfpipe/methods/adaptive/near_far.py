"""Former place of NearFar, until the shared environment is installed again; delete then."""

from importlib import import_module

NearFar = import_module("rfpipe.methods.near_far.method").NearFar
