"""The version of rfpipe, which its distribution takes from here."""

__all__ = ["__version__"]

__version__ = "0.1.0"
