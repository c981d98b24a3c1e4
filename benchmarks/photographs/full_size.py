"""Time and memory of a fit to pictures of the size that people have.

Pictures are simulated: a curved, textured surface seen from aside, with blur, noise and 8 bits.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

import rfpipe
from benchmarks.photographs.runs import run_fit
from rfpipe.fitting.binning import bin_image
from rfpipe.fitting.codes import code_patterns

CAMERA, PROJECTOR = (1500, 2048), (1080, 1920)
CODE, PICTURES = "gray:1920x1080", 46


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


def size_row(camera_bin: int = 10, projector_bin: int = 20) -> dict[str, object]:
    """Measure ``rfpipe fit`` of Gray code at full resolution.

    Returns
    -------
    dict
        ``camera_bin``, ``projector_bin``; ``cpu_s``, ``peak_gib``; ``median``, ``nine_tenths``
        (rays after binning) and ``beyond_2`` (percent) of the distances between places in the mask
        and the simulated ones; ``in_mask`` (percent of the pixels that see the projector).
    """
    bins = "--camera-bin", f"{camera_bin}", "--projector-bin", f"{projector_bin}"
    row: dict[str, object] = {"camera_bin": camera_bin, "projector_bin": projector_bin}
    with TemporaryDirectory() as scratch:
        folder, output = Path(scratch) / "pictures", Path(scratch) / "transport.zarr"
        truth = write_pictures(folder, CODE, PICTURES)
        run = run_fit(folder, output, "--patterns", CODE, *bins)
        row |= {"cpu_s": run.seconds, "peak_gib": run.peak_gib}
        if run.failed:
            return row | {"refused": " ".join(run.text.split())}
        matches = rfpipe.open_transport(output).correspondence()
    places = bin_image(np.moveaxis(truth, 0, -1), camera_bin) / projector_bin
    shape = np.array(PROJECTOR) / projector_bin
    inside = ((places > 0) & (places < shape)).all(axis=-1)
    compared = matches.mask & inside
    distance = np.linalg.norm(matches.places - places, axis=-1)[compared]
    return row | {
        "median": float(np.median(distance)),
        "nine_tenths": float(np.quantile(distance, 0.9)),
        "beyond_2": 100 * float((distance > 2).mean()),
        "in_mask": 100 * float(compared.sum() / inside.sum()),
    }
