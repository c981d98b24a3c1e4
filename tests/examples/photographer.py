"""A simulated photographer for offline rigs, independent of rfpipe's code.

``python photographer.py SHEET MATRIX.npy`` shows each picture listed in SHEET/patterns.json, in
order, to a scene with light transport MATRIX, shape (channels, camera rays, projector rays). It
writes a TIFF file of each exposure to SHEET/pictures. The camera is free of noise and linear, with
16 bits and a black level of 1,000 counts.
"""

import json
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

BLACK, FULL_SCALE, COUNTS_PER_SECOND = 1_000, 65_535, 15_000


def rays_of(path, shape):
    """Return the light of each ray: the middle pixel of its square of projector pixels."""
    codes = oiio.ImageBuf(str(path)).get_pixels(oiio.UINT8)[..., 0]
    height, width = codes.shape
    side = min(height // shape[0], width // shape[1])
    start_row, start_column = (height - side * shape[0]) // 2, (width - side * shape[1]) // 2
    rows = start_row + side * np.arange(shape[0]) + side // 2
    columns = start_column + side * np.arange(shape[1]) + side // 2
    return codes[np.ix_(rows, columns)].ravel() / 255


def photograph(sheet, matrix, expose):
    """Take all pictures of a sheet; `expose(radiance, seconds, key)` returns counts."""
    listing = json.loads((sheet / "patterns.json").read_text())
    height, width = listing["picture_size"]
    (sheet / "pictures").mkdir(exist_ok=True)
    count = 0
    for shown in listing["shown"]:
        light = rays_of(sheet / shown["file"], (height, width))
        radiance = np.moveaxis(matrix @ light, 0, -1).reshape(height, width, -1)
        for seconds in listing["exposures_s"]:
            picture = oiio.ImageBuf(np.ascontiguousarray(expose(radiance, seconds, shown["key"])))
            picture.specmod().attribute("ExposureTime", float(seconds))
            assert picture.write(str(sheet / "pictures" / f"IMG_{count}.tif"))
            count += 1


def counts(radiance, seconds, _key):
    """Return the counts of a camera without noise."""
    light = BLACK + COUNTS_PER_SECOND * seconds * radiance
    return np.clip(np.rint(light), 0, FULL_SCALE).astype(np.uint16)


if __name__ == "__main__":
    photograph(Path(sys.argv[1]), np.load(sys.argv[2]), counts)
