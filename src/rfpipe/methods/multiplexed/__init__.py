"""Multiplexed dual photography, see `rfpipe.methods.multiplexed.method`."""
