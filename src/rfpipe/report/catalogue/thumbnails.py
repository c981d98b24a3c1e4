"""Small pictures of scenes under all of the projector's light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.report.catalogue.items import floodlit_of

__all__ = ["write_thumbnail"]

_SIDE = 96
_WHITE_PERCENTILE = 99.5


def write_thumbnail(folder: Path, picture: Path) -> bool:
    """Write the floodlit picture of an acquisition as a small PNG, if it is captured.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``.
    picture : Path

    Returns
    -------
    bool
        Whether there is one.
    """
    from rfpipe.pictures.images import write_image

    floodlit = floodlit_of(folder)
    if floodlit is None:
        return False
    rays = floodlit.shape[:-1]
    # of a light field, the view in the middle
    domain = RayDomain(rays)
    views = floodlit.reshape(domain.views, *domain.image_shape, floodlit.shape[-1])
    image = _smaller(views[domain.views // 2])
    lit = image[np.isfinite(image)]
    white = float(np.percentile(lit, _WHITE_PERCENTILE)) if lit.size else 1.0
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_image(picture, np.nan_to_num(image), white if white > 0 else 1.0)
    return True


def _smaller(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Average a picture (H, W, C) over squares of pixels until it is small enough."""
    step = -(-max(image.shape[:2]) // _SIDE)
    height, width = (max(1, side // step) for side in image.shape[:2])
    cut = image[: height * step, : width * step]
    blocks = cut.reshape(height, cut.shape[0] // height, width, cut.shape[1] // width, -1)
    smaller: NDArray[np.float32] = blocks.mean(axis=(1, 3), dtype=np.float32)
    return smaller
