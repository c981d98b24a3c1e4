"""Errors of what was acquired: figures of relit pictures."""
