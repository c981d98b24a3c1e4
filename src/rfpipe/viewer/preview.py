"""The floodlit picture that a page shows before its data have come."""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.transport.base import Transport

__all__ = ["preview_of"]

_LARGEST = (
    40_000  # bytes; the page's own text takes as much again, and both come in the first 100 kB
)
_QUALITIES = (90, 80, 65, 50, 30)


def preview_of(transport: Transport, white: float) -> str:
    """Return the first view under floodlight as the address of a picture, a JPEG of 40 kB at most.

    Parameters
    ----------
    transport : Transport
    white : float
        Radiance shown as white.
    """
    import OpenImageIO as oiio

    from rfpipe.pictures.images import srgb

    domain = RayDomain(transport.camera_shape)
    floodlit = transport.relight(np.ones(transport.projector_shape, np.float32))
    view = floodlit.reshape(domain.views, *domain.image_shape, transport.channels)[0]
    shown = np.ascontiguousarray(srgb(view, white), np.float32)
    picture = oiio.ImageBuf(shown)
    found = b""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "preview.jpg"
        while not found or len(found) > _LARGEST:
            for quality in _QUALITIES:
                picture.specmod().attribute("Compression", f"jpeg:{quality}")
                picture.write(str(path), "uint8")
                found = path.read_bytes()
                if len(found) <= _LARGEST:
                    break
            else:
                half = oiio.ROI(
                    0, (picture.spec().width + 1) // 2, 0, (picture.spec().height + 1) // 2
                )
                picture = oiio.ImageBufAlgo.resize(picture, roi=half)
    return f"data:image/jpeg;base64,{b64encode(found).decode()}"
