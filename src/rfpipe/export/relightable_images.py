"""Relightable images (RTI) of domes: folders for OpenLIME and Relight, and PTM files.

A viewer computes the colour ``c`` of a pixel under light from the direction ``d`` (x right, y up,
z to the camera), as sRGB from 0 to 1, from a few numbers of each pixel. A folder has the type
``bilinear`` and the colour space ``mrgb`` of Relight [1]_, a PTM file a polynomial [2]_::

    c(d) = M(d) + sum_p B_p(d) a_p                         folder
    c(d) = a_0 x^2 + a_1 y^2 + a_2 x y + a_3 x + a_4 y + a_5         PTM file

=======  ==============  ====================  ====================================================
symbol   code name       shape                 meaning
=======  ==============  ====================  ====================================================
``M``    mean            (3 G)                 mean colour under light from the G directions of a
                                               grid, and its channels
``B_p``  basis           (3 G, P)              principal components of the pixels' colours under
                                               these lights
``a_p``  coefficients    (pixels, P)           of each pixel, stored in 8 bits
=======  ==============  ====================  ====================================================

Between the directions of the grid, the viewer interpolates linearly. The colours at the grid's
directions are those of `Relightable.light_from`.

.. [1] https://github.com/cnr-isti-vclab/relight
.. [2] T. Malzbender, D. Gelb: Polynomial Texture Map (.ptm) File Format 1.2, HP Labs 2001.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double, Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.export.movies import white_of
from rfpipe.lights.interpolation import unit
from rfpipe.output import OUTPUTS, suffix_of
from rfpipe.pictures.images import JPEG_QUALITY, srgb, write_jpeg
from rfpipe.ranges import ranges
from rfpipe.store.files import hidden_sibling, remove_tree, storage_errors, write_atomically
from rfpipe.transport.algebra import MEMORY_BUDGET, check_size
from rfpipe.transport.light_interpolation import LightInterpolation
from rfpipe.transport.relightable import Relightable

RESOLUTION = 16
"""Directions along a side of the grid."""

PLANES = 27
"""Coefficients of each pixel, three in each picture."""

LARGEST_PICTURE = 2048
"""Pixels of the longer side from which on tiles are written."""

_TILE = 256
_OVERLAP = 1
_SAMPLES = 4096
_CHUNK = 512
"""Rays at a time: their colours at all directions of the grid stay in the cache of a processor."""
_RIDGE = 1e-4
"""Regularisation of the polynomials, per light."""

_PTM_MIDDLE = 127

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<link rel="stylesheet" href="openlime/css/skin.css">
<style>
html, body {{ margin: 0; height: 100%; }}
.openlime {{ position: relative; height: 100%; }}
</style>
</head>
<body>
<div class="openlime"></div>
<!-- The folder openlime is a copy of the folder dist in the npm package openlime. -->
<script src="openlime/js/openlime.min.js"></script>
<script>
const viewer = new OpenLIME.Viewer(".openlime");
const layer = new OpenLIME.Layer({{ type: "rti", layout: "{layout}", url: "info.json" }});
viewer.addLayer("rti", layer);
OpenLIME.Skin.setUrl("openlime/skin/skin.svg");
const ui = new OpenLIME.UIBasic(viewer, {{ showLightDirections: true }});
ui.actions.light.active = true;
</script>
</body>
</html>
"""


class RelightableImage(NamedTuple):
    """Summary of a relightable image.

    Attributes
    ----------
    shape : tuple of int
        Height and width.
    error : float
        Norm of the difference from the pictures of the dome, over their norm, in sRGB. Compression
        of the planes as JPEG is not in it.
    white : float
        Radiance that is shown as white.
    """

    shape: tuple[int, int]
    error: float
    white: float


class _Dome(NamedTuple):
    """Pictures (channels, rays, lights), and which lights are in front of the object (z > 0)."""

    pictures: Float
    directions: Double
    in_front: Bools
    shape: tuple[int, int]
    white: float

    def colours(self, radiance: NDArray[Any]) -> Double:
        """Return radiance (channels, rays, D) as sRGB (D, 3, rays)."""
        return np.moveaxis(srgb(np.moveaxis(radiance, 0, -1), self.white), (0, 1, 2), (2, 0, 1))

    def sample(self) -> Index:
        """Return some rays that the lights light."""
        bright = np.flatnonzero(self.pictures.any(axis=(0, 2)))
        chosen = np.linspace(0, len(bright) - 1, min(len(bright), _SAMPLES)).astype(int)
        rays: Index = bright[chosen]
        return rays

    def error(self, shown: Double, sample: Index) -> float:
        """Return the error of shown colours (D, 3, samples) under the lights in front."""
        truth = self.colours(self.pictures[:, sample][..., self.in_front])
        return float(np.linalg.norm(np.clip(shown, 0, 1) - truth) / np.linalg.norm(truth))


def write_relightable_image(light: Relightable, output: Path) -> RelightableImage:
    """Write a relightable image that viewers of museums read.

    Parameters
    ----------
    light : Relightable
        A transport of single lights with known directions, some of them with z > 0.
    output : path
        A new folder for OpenLIME, with ``info.json``, the pictures ``plane_0.jpg`` and so on, tiles
        of large pictures (Deep Zoom), and the page ``index.html``; or a ``.ptm`` file for
        RTIViewer. Written completely or not at all.

    Raises
    ------
    InputError
        When the lights' directions are unknown or all behind the object, everything is black, the
        pictures take more than the memory budget, the folder exists, or the suffix is another one.
    StoreError
        When a file can't be written.
    """
    suffix = suffix_of(output, OUTPUTS["export --relight"])
    if not suffix and output.exists():
        raise InputError(f"{output}: exists already; remove it, or name another folder")
    advice = "fit the pictures with a larger --camera-bin"
    check_size("the pictures of the lights", light.shape, MEMORY_BUDGET, advice)
    interpolation = light.light_interpolation()
    directions = unit(np.asarray(light.lights))
    pictures = light.toarray()
    in_front = directions[:, 2] > 0
    if not any(pictures[..., index].any() for index in np.flatnonzero(in_front)):
        raise InputError(
            "all pictures of lights in front of the object (z > 0) are black, or there are none; "
            "check the lights' directions: z points to the camera"
        )
    white = white_of(pictures[..., index] for index in np.flatnonzero(in_front))
    shape = RayDomain(light.camera_shape).picture_shape
    dome = _Dome(pictures, directions, in_front, shape, white)
    return _write_ptm(dome, output) if suffix else _write_folder(dome, interpolation, output)


def ptm_functions(directions: Double) -> Double:
    """Return the functions of a PTM file at unit vectors (D, 3), shape (D, 6)."""
    x, y, _ = directions.T
    return np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], axis=1)


def grid_directions(resolution: int) -> Double:
    """Return the directions of Relight's bilinear grid, unit vectors (resolution**2, 3).

    The upper half of an octahedron is projected along z and turned by 45 degrees, so that it fills
    a square: its centre is z, its border the horizon. Rows are v, columns u, both from -1 to 1:
    ``u = (x + y) / s``, ``v = (y - x) / s`` with ``s = |x| + |y| + |z|``.
    """
    v, u = np.meshgrid(*[np.linspace(-1, 1, resolution)] * 2, indexing="ij")
    x, y = (u - v) / 2, (u + v) / 2
    z = np.maximum(1 - np.abs(x) - np.abs(y), 0)
    return unit(np.stack([x, y, z], axis=-1).reshape(-1, 3))


def grid_weights(directions: Double, resolution: int) -> Double:
    """Return the weights of the grid's directions, shape (D, resolution**2), for unit vectors."""
    x, y, z = directions.T
    size = np.abs(x) + np.abs(y) + np.abs(z)
    weights = np.ones((len(directions), resolution, resolution))
    for axis, place in ((2, (x + y) / size), (1, (y - x) / size)):
        distance = (place[:, None] + 1) / 2 * (resolution - 1) - np.arange(resolution)
        weights *= np.expand_dims(np.maximum(1 - np.abs(distance), 0), 3 - axis)
    return weights.reshape(len(directions), -1)


def _covered(interpolation: LightInterpolation, directions: Double) -> Double:
    """Replace directions far from all lights by the nearest ones that are covered."""
    dense = grid_directions(8 * RESOLUTION)
    candidates = dense[interpolation.interpolation.covered(dense)]
    covered = interpolation.interpolation.covered(directions)
    nearest = (directions @ candidates.T).argmax(axis=1)
    return np.where(covered[:, None], directions, candidates[nearest])


class _Components(NamedTuple):
    """Mean, basis and their codes in ``info.json``."""

    mean: Double
    basis: Double
    codes: NDArray[np.int64]
    ranges: Double


def _components(colours: Double) -> _Components:
    """Return the principal components of colours (3 G, rays), rounded as in ``info.json``."""
    from scipy.linalg import eigh

    count = len(colours)
    mean = np.rint(255 * colours.mean(axis=1)) / 255
    residual = colours - mean[:, None]
    largest = [count - PLANES, count - 1]
    basis = eigh(residual @ residual.T, subset_by_index=largest)[1][:, ::-1]
    scale = 127 / np.abs(basis).max(axis=0)
    steps = np.rint(basis * scale)
    codes = np.vstack([np.rint(255 * mean), steps.T + 127]).astype(np.int64)
    return _Components(mean, steps / scale, codes, scale)


def _write_folder(dome: _Dome, interpolation: LightInterpolation, folder: Path) -> RelightableImage:
    directions = _covered(interpolation, grid_directions(RESOLUTION))

    def grid_colours(rays: Index | slice) -> Double:
        radiance = interpolation.pictures_from(directions, dome.pictures[:, rays], rays)
        return dome.colours(radiance).reshape(3 * len(directions), -1)

    sample = dome.sample()
    components = _components(grid_colours(sample))
    solve = np.linalg.pinv(components.basis)
    coefficients = np.empty((dome.pictures.shape[1], PLANES), np.float32)
    for first, last in ranges(len(coefficients), _CHUNK):
        residual = grid_colours(slice(first, last)) - components.mean[:, None]
        coefficients[first:last] = (solve @ residual).T
    lowest = coefficients.min(axis=0)
    scale = np.maximum(coefficients.max(axis=0) - lowest, 1e-6)
    coefficients -= lowest
    coefficients *= 255 / scale
    codes = np.rint(coefficients, out=coefficients).astype(np.uint8)
    restored = components.mean + (codes[sample] / 255 * scale + lowest) @ components.basis.T
    grid = restored.T.reshape(len(directions), -1)
    lights = dome.directions[dome.in_front]
    shown = (grid_weights(lights, RESOLUTION) @ grid).reshape(len(lights), 3, -1)
    info = {
        "lights": lights.round(6).ravel().tolist(),
        "basis": components.codes.ravel().tolist(),
        "materials": [
            {
                "range": components.ranges.tolist(),
                "scale": scale.tolist(),
                "bias": (-lowest / scale).tolist(),
            }
        ],
    }
    _write_planes(folder, codes.reshape(*dome.shape, PLANES), info)
    return RelightableImage(dome.shape, dome.error(shown, sample), dome.white)


def _write_planes(folder: Path, codes: NDArray[np.uint8], of_basis: dict[str, Any]) -> None:
    """Write the files of a folder, completely or not at all.

    `of_basis` are the entries of ``info.json`` that depend on the lights and the basis.
    """
    height, width = codes.shape[:2]
    info = {
        "width": width,
        "height": height,
        "format": "jpg",
        "type": "bilinear",
        "resolution": RESOLUTION,
        "colorspace": "mrgb",
        "nplanes": PLANES,
        "quality": JPEG_QUALITY,
        **of_basis,
    }
    is_large = max(height, width) > LARGEST_PICTURE
    page = _PAGE.format(title=folder.name, layout="deepzoom" if is_large else "image")
    new = hidden_sibling(folder, "new")
    try:
        remove_tree(new)
        for plane in range(PLANES // 3):
            picture = codes[..., 3 * plane : 3 * plane + 3]
            write_jpeg(new / f"plane_{plane}.jpg", picture)
            if is_large:
                _write_tiles(new / f"plane_{plane}", picture)
        write_atomically(new / "info.json", json.dumps(info).encode(), resumes=False)
        write_atomically(new / "index.html", page.encode(), resumes=False)
        with storage_errors(folder, "writing", resumes=False):
            new.rename(folder)
    finally:
        remove_tree(new)


def _write_tiles(name: Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture as Deep Zoom tiles, as OpenLIME numbers them: level 0 is a single tile."""
    height, width = picture.shape[:2]
    header = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<Image xmlns="http://schemas.microsoft.com/deepzoom/2008" Format="jpg" '
        f'Overlap="{_OVERLAP}" TileSize="{_TILE}"><Size Width="{width}" Height="{height}"/>'
        "</Image>\n"
    )
    write_atomically(name.with_suffix(".dzi"), header.encode(), resumes=False)
    levels = int(np.ceil(np.log2(max(height, width) / _TILE)))
    for level in range(levels, -1, -1):
        height, width = picture.shape[:2]
        for row in range(0, height, _TILE):
            for column in range(0, width, _TILE):
                part = picture[
                    max(row - _OVERLAP, 0) : row + _TILE + _OVERLAP,
                    max(column - _OVERLAP, 0) : column + _TILE + _OVERLAP,
                ]
                place = f"{level}/{column // _TILE}_{row // _TILE}.jpg"
                write_jpeg(name.with_name(f"{name.name}_files") / place, part)
        even = picture[: height // 2 * 2, : width // 2 * 2].astype(np.float32)
        halved = even.reshape(height // 2, 2, width // 2, 2, 3).mean(axis=(1, 3))
        picture = np.rint(halved).astype(np.uint8)


def _write_ptm(dome: _Dome, file: Path) -> RelightableImage:
    """Write the six coefficients of each pixel and channel, rows from the bottom to the top."""
    functions = ptm_functions(dome.directions) * dome.in_front[:, None]
    ridge = _RIDGE * len(functions) * np.eye(functions.shape[1])
    solve = np.linalg.solve(functions.T @ functions + ridge, functions.T)
    coefficients = np.empty((3, dome.pictures.shape[1], 6), np.float32)
    for first, last in ranges(coefficients.shape[1], _CHUNK):
        colours = dome.colours(dome.pictures[:, first:last])
        coefficients[:, first:last] = np.einsum("ld,dcr->crl", solve, colours)
    # a viewer computes (code - bias) * scale, 0 to 255; both are shared by the channels
    coefficients *= 255
    lowest, highest = coefficients.min(axis=(0, 1)), coefficients.max(axis=(0, 1))
    scale = np.maximum(np.maximum(highest / (255 - _PTM_MIDDLE), -lowest / _PTM_MIDDLE), 1e-3)
    codes = np.rint(coefficients / scale + _PTM_MIDDLE).astype(np.uint8)
    height, width = dome.shape
    lines = [
        "PTM_1.2",
        "PTM_FORMAT_RGB",
        str(width),
        str(height),
        " ".join(f"{value:.7g}" for value in scale.tolist()),
        " ".join([str(_PTM_MIDDLE)] * 6),
        "",
    ]
    upwards = codes.reshape(3, height, width, 6)[:, ::-1]
    write_atomically(file, "\n".join(lines).encode() + upwards.tobytes(), resumes=False)
    sample = dome.sample()
    restored = (codes[:, sample].astype(np.float64) - _PTM_MIDDLE) * scale / 255
    shown = np.einsum("dl,crl->dcr", functions[dome.in_front], restored)
    return RelightableImage(dome.shape, dome.error(shown, sample), dome.white)
