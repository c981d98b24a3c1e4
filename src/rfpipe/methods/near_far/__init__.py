"""Near/far acquisition: direct light apart, indirect light smooth at the scale of its distance."""
