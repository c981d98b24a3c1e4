"""Cameras that expose frame by frame: GenICam and Basler."""
