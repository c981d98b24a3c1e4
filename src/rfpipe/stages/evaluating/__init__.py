"""Errors of what was acquired: figures, sweeps and studies."""
