"""Acquire, store and relight the light transport between a projector and a camera.

`open_transport` opens what a run stored, `open_collection` that of all its scenes, `coarser`
lowers a transport's resolution, `crop` takes a view or a part of one, `picture_weights` makes a
pattern of a picture, `environment_weights` of a panorama the weights of lights, whose directions
`read_lights` reads, `environment_coverage` the share of its light that they cover; `acquire`
runs a whole acquisition in this process; `OperatorRig` is a rig made from a matrix or linear
operator, which `read_matrix` finds in files of other programs, and `CameraModel` the camera
that it may be given; `errors` are all that rfpipe raises on purpose. All but these are imported
when they are first used, so that ``import rfpipe`` stays quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from rfpipe import errors
from rfpipe.caches import ensure_cache_folders as _ensure_cache_folders

if TYPE_CHECKING:
    from rfpipe.environment import environment_coverage as environment_coverage
    from rfpipe.environment import environment_weights as environment_weights
    from rfpipe.light_files import read_lights as read_lights
    from rfpipe.photometry import CameraModel as CameraModel
    from rfpipe.relighting import picture_errors as picture_errors
    from rfpipe.relighting import relighting_pictures as relighting_pictures
    from rfpipe.rigs import OperatorRig as OperatorRig
    from rfpipe.stages.acquire import acquire as acquire
    from rfpipe.transport import coarser as coarser
    from rfpipe.transport import open_transport as open_transport
    from rfpipe.transport.collection import Collection as Collection
    from rfpipe.transport.collection import open_collection as open_collection
    from rfpipe.transport.matrix_reading import read_matrix as read_matrix
    from rfpipe.transport.regrouping import crop as crop
    from rfpipe.version import __version__ as __version__
    from rfpipe.weights import picture_weights as picture_weights

_ensure_cache_folders()  # before any library looks for its own

_HOMES = {
    "CameraModel": "rfpipe.photometry",
    "Collection": "rfpipe.transport.collection",
    "OperatorRig": "rfpipe.rigs",
    "__version__": "rfpipe.version",
    "acquire": "rfpipe.stages.acquire",
    "coarser": "rfpipe.transport",
    "crop": "rfpipe.transport.regrouping",
    "environment_coverage": "rfpipe.environment",
    "environment_weights": "rfpipe.environment",
    "open_collection": "rfpipe.transport.collection",
    "open_transport": "rfpipe.transport",
    "picture_errors": "rfpipe.relighting",
    "picture_weights": "rfpipe.weights",
    "read_lights": "rfpipe.light_files",
    "read_matrix": "rfpipe.transport.matrix_reading",
    "relighting_pictures": "rfpipe.relighting",
}

__all__ = ["errors", *_HOMES]  # noqa: PLE0604


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'rfpipe' has no attribute {name!r}")
    value: object = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
