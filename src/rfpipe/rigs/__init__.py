"""Rigs: a projector and a camera that show patterns and return brackets."""

from rfpipe.keys import (
    BLACK_LEVEL_KEY,
    DRIFT_KEY,
    FLOODLIT_KEY,
    LOOK_KEY,
    SYMMETRY_KEY,
    VERIFICATION_KEY,
    WARM_UP_KEY,
)
from rfpipe.rigs.base import Rig
from rfpipe.rigs.device_rig import DeviceRig
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.rigs.operator import OperatorRig, SimulatedRig
from rfpipe.rigs.remote import RemoteRig

__all__ = [
    "BLACK_LEVEL_KEY",
    "DRIFT_KEY",
    "FLOODLIT_KEY",
    "LOOK_KEY",
    "SYMMETRY_KEY",
    "VERIFICATION_KEY",
    "WARM_UP_KEY",
    "Camera",
    "DeviceRig",
    "OperatorRig",
    "Projector",
    "ProjectorLayout",
    "RemoteRig",
    "Rig",
    "SimulatedRig",
]
