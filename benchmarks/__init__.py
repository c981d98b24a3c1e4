"""Benchmarks of methods, rivals and speed (README.md)."""
