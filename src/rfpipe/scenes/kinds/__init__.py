"""The kinds of scenes that rfpipe comes with, each with its options."""
