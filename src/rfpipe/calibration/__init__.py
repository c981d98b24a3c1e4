"""Calibration of a rig: noise, responses, correspondence, rays and symmetry, with verdicts."""

from rfpipe.calibration.folder import CalibrationFolder, calibrate, finish
from rfpipe.calibration.steps import STEPS, steps_of
from rfpipe.rigs.calibrated import Calibration
from rfpipe.rigs.calibrated import load_calibration as load

__all__ = [
    "STEPS",
    "Calibration",
    "CalibrationFolder",
    "calibrate",
    "finish",
    "load",
    "steps_of",
]
