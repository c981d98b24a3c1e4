"""Version of rfpipe, read by the build of its distribution."""

__version__ = "0.1.0"
