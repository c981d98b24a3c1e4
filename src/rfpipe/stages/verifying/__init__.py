"""Checking a run's folder: every store, chunk, manifest and table; and how to mend it."""
