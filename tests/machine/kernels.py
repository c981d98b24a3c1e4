"""Compilation of the kernels once for all workers and their jobs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rfpipe import OperatorRig, acquire, open_transport
from rfpipe.config import CameraConfig
from rfpipe.methods.dual import Dual
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.near_far.method import NearFar
from rfpipe.methods.symmetric.method import Symmetric
from rfpipe.scenes import reference_scene
from rfpipe.transport import save_transport


def compile_kernels(folder: Path) -> None:
    """Acquire, store and relight a small scene, which fills numba's cache on disk."""
    shape = (12, 12)
    rig = OperatorRig(reference_scene("IV", shape, channels=1), shape, shape, CameraConfig())
    for method in (Symmetric(), Dual(), NearFar(), Footprints()):
        transport = acquire(rig, method, progress=False).transport
        path = folder / f"{method.name}.zarr"
        save_transport(transport, path, number_format="uint8")
        open_transport(path).relight(np.ones(shape))
