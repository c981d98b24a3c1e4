"""The stages of an acquisition: schedule, capture, merge, normalize, refine, assemble, relight.

Each works on files and is called by the workflow's script of its name; `acquire` runs the same
steps in one process.
"""
