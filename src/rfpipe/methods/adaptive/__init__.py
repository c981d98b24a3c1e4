"""Adaptive acquisition: rounds of patterns until held-out pictures are predicted well enough."""
