"""Footprint acquisition: near/far acquisition for rigs whose camera and projector stand apart."""
