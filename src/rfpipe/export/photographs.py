"""Relit photographs for other programs: one light at a time, normals, patterns of papers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.export.movies import relit_pictures
from rfpipe.light_files import write_directions
from rfpipe.lights.interpolation import unit
from rfpipe.output import OUTPUTS, suffix_of
from rfpipe.pictures.images import write_code_picture, write_image, write_parts
from rfpipe.provenance import generator
from rfpipe.relighting import shapes
from rfpipe.store.files import hidden_sibling, remove_tree, storage_errors
from rfpipe.transport.algebra import RaySelection, check_size, selected_rays
from rfpipe.transport.normals import Normals
from rfpipe.transport.regrouping import cell_sums
from rfpipe.transport.relightable import LIMIT, Relightable
from rfpipe.weights import picture_weights


def write_lights(
    light: Relightable,
    file: Path,
    rays: RaySelection = None,
    *,
    side: int = 1,
    limit_bytes: int = LIMIT,
) -> int:
    """Write the pictures under one light at a time (OLAT) as parts of an EXR file.

    If the transport has the directions of its lights, they are written to a file with the suffix
    ``.lp``: a line for each part, with its name and x, y, z. Joined rays have their mean
    direction. ``rfpipe fit`` reads both files.

    Parameters
    ----------
    light : Relightable
        The transport.
    file : path
        Written completely or not at all.
    rays
        Projector rays, or squares of `side` by `side` rays, see
        `rfpipe.transport.algebra.RaySelection`. There is a part for each, in this order, named by
        row and column as in ``light_31_35``. By default, all rays.
    side : int
        Side of the squares in rays.
    limit_bytes : int
        Largest size of the pictures before compression.

    Returns
    -------
    int
        Number of pictures.

    Raises
    ------
    InputError
        When a ray doesn't exist, or the pictures are larger than the limit.
    StoreError
        When the file can't be written.
    """
    grid, members = cell_sums(light.projector_shape, side)
    chosen = selected_rays(rays, grid, "lights")
    shape = (*RayDomain(light.camera_shape).picture_shape, light.channels)
    remedy = "choose columns, join rays (2 x 2: 4 times smaller), or raise the limit"
    check_size(f"{file}: a file", (len(chosen), *shape), limit_bytes, remedy)
    positions = np.transpose(np.unravel_index(chosen, grid))
    names = ["_".join(map(str, ("light", *position))) for position in positions]
    patterns = (members[[ray]].toarray().reshape(light.projector_shape) for ray in chosen)
    write_parts(file, names, shape, relit_pictures(light, patterns))
    directions_file = file.with_suffix(".lp")
    directions_file.unlink(missing_ok=True)
    if light.lights is not None:
        directions = np.asarray(members[chosen] @ unit(light.lights))
        write_directions(directions_file, names, directions)
    return len(names)


def write_normals(light: Relightable, file: Path) -> Normals:
    """Write normals, albedo and uncertainty, and return them.

    Parameters
    ----------
    light : Relightable
        A transport of single lights with known directions.
    file : path
        An ``.exr`` file has the parts ``normals`` (x, y, z, each -1 to 1), ``albedo`` and
        ``uncertainty`` (degrees), float32. A ``.png`` file is a normal map of 8 bits,
        ``(n + 1) / 2``, black outside the mask.

    Raises
    ------
    InputError
        As `rfpipe.transport.normals.normals_of`, or when the file has another suffix.
    """
    suffix = suffix_of(file, OUTPUTS["export --normals"])
    result = light.normals()
    shape = RayDomain(light.camera_shape).picture_shape
    normals = result.normals.reshape(*shape, 3)
    if suffix == ".png":
        write_code_picture(file, (normals / 2 + 0.5) * result.mask.reshape(*shape, 1))
    else:
        albedo = np.broadcast_to(result.albedo.reshape(*shape, -1), (*shape, 3))
        uncertainty = np.broadcast_to(result.uncertainty.reshape(*shape, 1), (*shape, 3))
        parts = {"normals": normals, "albedo": albedo, "uncertainty": uncertainty}
        write_parts(file, list(parts), (*shape, 3), parts.values())
    return result


def write_photographs(
    light: Relightable,
    folder: Path,
    training: int,
    validation: int,
    *,
    seed: int = 0,
    form: str = "png",
) -> float:
    """Write patterns and relit photographs in the layout of papers on projector-camera systems.

    The patterns are in ``ref`` (black, white, grey), ``train`` and ``test`` (random shapes,
    different in each channel), the photographs in ``cam/raw``. `rfpipe.fitting.read_series` reads
    this layout.

    Parameters
    ----------
    light : Relightable
        The transport.
    folder : path
        A new folder, written completely or not at all.
    training, validation : int
        Numbers of patterns.
    seed : int
        Seed of the random patterns.
    form : str
        ``png``, sRGB of 8 bits, or ``exr``, weights and radiance.

    Returns
    -------
    float
        Radiance that becomes white in a PNG: 10 % above the largest radiance under white light, so
        that no pixel counts as saturated.

    Raises
    ------
    InputError
        When the folder exists, or a number of patterns is too small.
    """
    if training < 1 or validation < 0:
        raise InputError(
            f"{training} training and {validation} validation patterns; expected at least 1 and 0"
        )
    if folder.exists():
        raise InputError(f"{folder}: exists already; remove it, or name another folder")
    white = 1.1 * float(light.relight(np.ones(light.projector_shape)).max())
    new = hidden_sibling(folder, "new")
    try:
        remove_tree(new)
        for name, pattern in _patterns(light, training, validation, seed):
            (photograph,) = relit_pictures(light, [pattern.reshape(*light.projector_shape, -1)])
            for place, picture, top in (("", pattern, 1.0), ("cam/raw", photograph, white)):
                write_image(new / place / f"{name}.{form}", picture, top)
        with storage_errors(folder, "writing", resumes=False):
            new.rename(folder)
    finally:
        remove_tree(new)
    return white


def _patterns(
    light: Relightable, training: int, validation: int, seed: int
) -> Iterator[tuple[str, Float]]:
    """Yield names and patterns (H, W, C), with views stacked vertically."""
    size, channels = RayDomain(light.projector_shape).picture_shape, light.channels
    for index, level in enumerate(picture_weights(np.array([0, 255, 128], np.uint8), "srgb")):
        yield f"ref/img_{index + 1:04d}", np.full((*size, channels), level)
    for subset, first, count in (("train", 0, training), ("test", training, validation)):
        for index in range(count):
            keys = [(first + index, channel) for channel in range(channels)]
            planes = [shapes(size, generator(seed, *key)) for key in keys]
            yield f"{subset}/img_{index + 1:04d}", np.stack(planes, axis=-1).astype(np.float32)
