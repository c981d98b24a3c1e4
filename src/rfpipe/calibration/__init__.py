"""Calibration of a rig: noise, responses, correspondence, rays and symmetry, with verdicts."""
