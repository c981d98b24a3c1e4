"""Rigs: a projector and a camera that show patterns and return brackets."""

from rfpipe.rigs.base import BLACK_LEVEL_KEY, FLOODLIT_KEY, PatternOperator, Rig
from rfpipe.rigs.operator import OperatorRig
from rfpipe.rigs.remote import RemoteRig
from rfpipe.rigs.simulated import CoaxialScene, SimulatedRig

__all__ = [
    "BLACK_LEVEL_KEY",
    "FLOODLIT_KEY",
    "CoaxialScene",
    "OperatorRig",
    "PatternOperator",
    "RemoteRig",
    "Rig",
    "SimulatedRig",
]
