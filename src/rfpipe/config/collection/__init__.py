"""Collections: files whose rows are the scenes of a run, CSV or YAML."""

from rfpipe.config.collection.gather import Gathered, check_files, gather

__all__ = ["Gathered", "check_files", "gather"]
