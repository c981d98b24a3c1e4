"""Rigs: a projector and a camera that show patterns and return brackets."""

from rfpipe.rigs.base import Rig
from rfpipe.rigs.build import DeviceRig
from rfpipe.rigs.devices import Camera, Projector
from rfpipe.rigs.layout import ProjectorLayout
from rfpipe.rigs.operator import OperatorRig, SimulatedRig
from rfpipe.rigs.remote import RemoteRig

__all__ = [
    "Camera",
    "DeviceRig",
    "OperatorRig",
    "Projector",
    "ProjectorLayout",
    "RemoteRig",
    "Rig",
    "SimulatedRig",
]
