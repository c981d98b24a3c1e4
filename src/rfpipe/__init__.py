"""Acquire, store and relight the light transport between a projector and a camera.

``open_transport`` opens what a run stored, ``open_collection`` that of all its scenes, ``coarser``
lowers a transport's resolution, ``crop`` takes a view or a part of one, ``picture_weights`` makes a
pattern of a picture, ``environment_weights`` of a panorama the weights of lights, whose directions
``read_lights`` reads; ``acquire`` runs a whole acquisition in this process; ``OperatorRig`` is a
rig made from a matrix or linear operator, which ``read_matrix`` finds in files of other programs,
and ``CameraModel`` the camera that it may be given; ``errors`` are all that rfpipe raises on
purpose. All but these are imported when they are first used, so that ``import rfpipe`` stays quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from rfpipe import errors

if TYPE_CHECKING:
    from rfpipe.environment import environment_weights, read_lights
    from rfpipe.photometry import CameraModel
    from rfpipe.relighting import picture_errors, relighting_pictures
    from rfpipe.rigs import OperatorRig
    from rfpipe.stages.acquire import acquire
    from rfpipe.transport import coarser, open_transport
    from rfpipe.transport.collection import Collection, open_collection
    from rfpipe.transport.matrix_in import read_matrix
    from rfpipe.transport.rays import crop
    from rfpipe.version import __version__
    from rfpipe.weights import picture_weights

__all__ = [
    "CameraModel",
    "Collection",
    "OperatorRig",
    "__version__",
    "acquire",
    "coarser",
    "crop",
    "environment_weights",
    "errors",
    "open_collection",
    "open_transport",
    "picture_errors",
    "picture_weights",
    "read_lights",
    "read_matrix",
    "relighting_pictures",
]

_HOMES = {
    "CameraModel": "rfpipe.photometry",
    "Collection": "rfpipe.transport.collection",
    "OperatorRig": "rfpipe.rigs",
    "__version__": "rfpipe.version",
    "acquire": "rfpipe.stages.acquire",
    "coarser": "rfpipe.transport",
    "crop": "rfpipe.transport.rays",
    "environment_weights": "rfpipe.environment",
    "open_collection": "rfpipe.transport.collection",
    "open_transport": "rfpipe.transport",
    "picture_errors": "rfpipe.relighting",
    "picture_weights": "rfpipe.weights",
    "read_lights": "rfpipe.environment",
    "read_matrix": "rfpipe.transport.matrix_in",
    "relighting_pictures": "rfpipe.relighting",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'rfpipe' has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
