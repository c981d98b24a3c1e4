"""Drivers of projectors and cameras, and the optical bench in software."""
