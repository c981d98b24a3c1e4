"""Brackets into radiance: calibrating references, the merge itself, and its images."""
