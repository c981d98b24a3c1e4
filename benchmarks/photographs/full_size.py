"""Time and memory of a fit to pictures of the size that people have.

Pictures are simulated: a curved, textured surface seen from aside, with blur, noise and 8 bits.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from rfpipe.fitting.codes import code_patterns

CAMERA, PROJECTOR = (1500, 2048), (1080, 1920)


def write_pictures(folder: Path, spec: str, count: int, seed: int = 0) -> NDArray[np.float64]:
    """Write simulated pictures of a code as PNG files.

    Parameters
    ----------
    folder : Path
        A new folder.
    spec : str
        Code of a projector of `PROJECTOR` pixels.
    count : int
        Pictures of the code.

    Returns
    -------
    ndarray of float64, shape (2, H, W)
        Row and column of the projector, in pixels, of each camera pixel.
    """
    random = np.random.default_rng(seed)
    height = CAMERA[0]
    row, column = np.indices(CAMERA) / height - 0.5
    depth = 0.06 * np.sin(5 * row + 1) * np.cos(4 * column) + 0.05 * (column > 0.35)
    places = np.stack(
        [
            (0.92 * row + 0.06 * column + 0.5) * PROJECTOR[0],
            (0.52 * (column - 0.18 + depth) - 0.03 * row + 0.5) * PROJECTOR[1],
        ]
    )
    albedo = 0.3 + 0.6 * (gaussian_filter(random.standard_normal(CAMERA), 6) > 0)
    folder.mkdir()
    means = np.linspace(0.5, 0.4, count)
    means[-2:] = 1, 0  # white and black come last
    for index, read in enumerate(code_patterns(spec, count, means).readers):
        pattern = gaussian_filter(np.asarray(read(), np.float32), 0.5)
        direct = map_coordinates(pattern, places - 0.5, order=1, mode="constant")
        light = albedo * (0.5 * direct + 0.1 * pattern.mean()) + 0.02
        counts = 255 * light + 0.8 * random.standard_normal(CAMERA)
        pixels = np.rint(np.clip(counts, 0, 255)).astype(np.uint8)
        colours = np.repeat(pixels[..., None], 3, axis=2)
        assert oiio.ImageBuf(np.ascontiguousarray(colours)).write(str(folder / f"{index:02d}.png"))
    return places
