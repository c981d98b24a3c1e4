"""Devices beside a Basler camera and a window, as extras: found by entry points of rfpipe."""
