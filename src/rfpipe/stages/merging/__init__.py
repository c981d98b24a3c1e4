"""Brackets into radiance: what the references tell, the merge itself, and its images."""
