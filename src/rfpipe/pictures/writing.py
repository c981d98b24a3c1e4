"""Pictures for a projector's program."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

__all__ = ["write_code_picture"]


def write_code_picture(path: Path, light: NDArray[Any], gamma: float = 1.0) -> None:
    """Write a grey PNG of 8 bits for a projector whose light goes with ``code**gamma``.

    Parameters
    ----------
    path : Path
    light : ndarray, shape (H, W)
        Weights from 0 to 1.
    gamma : float
        Above 0.

    Raises
    ------
    InputError
        When the file can't be written.
    """
    import OpenImageIO as oiio

    codes = np.rint(255 * np.clip(light, 0, 1) ** (1 / gamma)).astype(np.uint8)
    picture = oiio.ImageBuf(np.ascontiguousarray(codes[..., None]))
    if not picture.write(str(path)):
        raise InputError(f"{path}: can't be written: {picture.geterror()}")
