"""Transport as footprints and smooth exchange, as footprint acquisition finds it."""
