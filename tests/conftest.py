"""Shared by all tests: hypothesis draws the same examples in every run, without a time limit."""

from hypothesis import settings

settings.register_profile("rfpipe", derandomize=True, deadline=None, max_examples=50)
settings.load_profile("rfpipe")
