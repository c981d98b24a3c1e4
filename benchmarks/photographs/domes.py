"""Errors of pictures under lights that are left out of a dome, compared with simple methods.

`dome_tables` takes a folder of pictures of one light at a time and their directions, such as the
set of the University of Washington, or of any dome. `simulated_table` takes simulated objects. No
seed of it was used to choose constants of `rfpipe.lights`: a separate prototype with its own
objects and seeds chose them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.photographs.simulated import DOMES, OBJECTS, simulated_dome
from rfpipe.array_types import Bools, Double
from rfpipe.light_files import lights_in
from rfpipe.lights.interpolation import angles_between, interpolate, trend, unit
from rfpipe.lights.shading import fit_shading, shaded
from rfpipe.pictures.images import read_image

Predict = Callable[[Double, Double, Double], Double]
"""Pictures (D, P) of lights (D, 3), from directions (L, 3) and pictures (L, P)."""

SUBSETS = (8, 12, 16, 24, 32, 48)
"""Numbers of lights that predict the others of a dome."""

_SAMPLES = 8192
"""Values of a picture that are compared."""


def nearest(lights: Double, directions: Double, pictures: Double) -> Double:
    """Take the picture of the nearest light."""
    return pictures[(directions @ lights.T).argmax(axis=1)]


def triangles(lights: Double, directions: Double, pictures: Double) -> Double:
    """Interpolate within triangles of the convex hull, else take the nearest light."""
    from scipy.spatial import ConvexHull

    predicted = nearest(lights, directions, pictures)
    corners = ConvexHull(lights).simplices
    for index, direction in enumerate(directions):
        inside = np.linalg.pinv(lights[corners].swapaxes(1, 2)) @ direction
        # the triangle that the ray meets nearest to the sphere has the smallest sum
        size = np.where(inside.min(axis=1) > -1e-9, inside.sum(axis=1), np.inf)
        if size.min() < 3:
            weights = inside[size.argmin()]
            predicted[index] = weights @ pictures[corners[size.argmin()]] / weights.sum()
    return predicted


def _regression(name: str) -> Predict:
    def predict(lights: Double, directions: Double, pictures: Double) -> Double:
        functions = trend(name, lights)
        count = functions.shape[1]
        ridge = len(lights) * (1e-3 if len(lights) < 1.5 * count else 1e-5) * np.eye(count)
        moments = functions.T @ functions + ridge
        solution: Double = np.linalg.solve(moments, functions.T @ pictures)
        return trend(name, directions) @ solution

    return predict


def kriging(lights: Double, directions: Double, pictures: Double) -> Double:
    """Krige with a constant trend; scale and nugget by leaving one light out."""
    products, count = pictures @ pictures.T, len(lights)
    angles, best = angles_between(lights, lights), (np.inf, 1.0, 0.0)
    for scale in np.radians([10, 20, 40, 60, 90, 150, 300]):
        for nugget in (0, 0.01, 0.05, 0.15):
            inverse = np.linalg.inv(np.exp(-angles / scale) + nugget * np.eye(count))
            column = inverse.sum(axis=1, keepdims=True)
            inverse = inverse - column @ column.T / column.sum()
            squares = np.diag(inverse @ products @ inverse) / np.diag(inverse) ** 2
            error = np.sqrt(np.maximum(squares, 0) / np.diag(products)).mean()
            best = min(best, (error, scale, nugget))
    _, scale, nugget = best
    system = np.ones((count + 1, count + 1))
    system[:count, :count] = np.exp(-angles / scale) + nugget * np.eye(count)
    system[count, count] = 0
    right = np.ones((count + 1, len(directions)))
    right[:count] = np.exp(-angles_between(lights, directions) / scale)
    weights: Double = np.linalg.solve(system, right)[:count].T
    return weights @ pictures


def ours(lights: Double, directions: Double, pictures: Double) -> Double:
    """Interpolate as `Relightable.light_from` does."""
    chosen = np.linspace(0, pictures.shape[1] - 1, 1024).astype(int)
    interpolation = interpolate(pictures[:, np.unique(chosen)], lights)
    weights, share, shading = interpolation.weights(directions)
    predicted = weights @ pictures
    if interpolation.has_shading:
        b = fit_shading(pictures, lights).vectors
        predicted += share[:, None] * shaded(b, directions) - shading @ shaded(b, lights)
    return predicted


METHODS: dict[str, Predict] = {
    "nearest": nearest,
    "triangles": triangles,
    "Lambert": _regression("linear"),
    "SH 2": _regression("harmonics2"),
    "SH 3": _regression("harmonics3"),
    "kriging": kriging,
    "rfpipe": ours,
}


def dome_tables(folder: Path) -> pd.DataFrame:
    """Return errors between the lights of all domes in a folder.

    Parameters
    ----------
    folder : Path
        It and its folders may each hold pictures of one light at a time, with a mask whose name
        has ``mask`` in it; the file of lights is beside the pictures or in the folder above.

    Returns
    -------
    DataFrame
        A row for each dome and number of lights (``lights``: all but one, and `SUBSETS` of domes
        with more lights), a column for each of `METHODS`: the norm of the difference over the norm
        of the picture, percent, mean over the lights that are left out. ``light`` is ``rgb``, or
        ``grey`` for the mean of the channels.
    """
    rows = []
    for place in sorted({folder, *(path for path in folder.iterdir() if path.is_dir())}):
        dome = read_dome(place)
        if dome is not None:
            colours = np.moveaxis(dome[0], -1, 1)[:, :, dome[2]]
            for light, pictures in (("rgb", colours), ("grey", colours.mean(axis=1)[:, None])):
                rows += [
                    {"dome": place.name, "light": light, **row} for row in _rows(pictures, dome[1])
                ]
    return pd.DataFrame(rows)


def simulated_table(seeds: range, subsets: tuple[int, ...] = SUBSETS) -> pd.DataFrame:
    """Return errors on simulated domes; columns of `dome_tables`, and ``object``."""
    rows = []
    for seed in seeds:
        kind, dome = OBJECTS[seed % len(OBJECTS)], DOMES[seed // 2 % len(DOMES)]
        pictures, directions = simulated_dome(kind, dome, seed, (0, 0.05, 0.15)[seed % 3])
        for row in _rows(pictures, directions, subsets, all_but_one=False):
            rows.append({"dome": dome, "object": kind, "seed": seed, **row})
    return pd.DataFrame(rows)


def _rows(
    pictures: NDArray[np.float32],
    lights: Double,
    subsets: tuple[int, ...] = SUBSETS,
    all_but_one: bool = True,
) -> Iterator[dict[str, float]]:
    """Yield the errors of all methods for numbers of lights."""
    count = len(pictures)
    values = pictures.reshape(count, -1).astype(np.float64)
    chosen = np.linspace(0, values.shape[1] - 1, _SAMPLES).astype(int)
    values, lights = values[:, np.unique(chosen)], unit(lights)
    splits = []
    if all_but_one and count <= 2 * SUBSETS[0]:
        splits.append((count - 1, [np.delete(np.arange(count), i) for i in range(count)]))
    order = np.random.default_rng(0).permutation(count)
    splits += [(k, [np.sort(order[:k])]) for k in subsets if k < count - 4]
    for number, parts in splits:
        errors: dict[str, list[float]] = {name: [] for name in METHODS}
        for held_out in parts:
            used = np.setdiff1d(np.arange(count), held_out)
            for name, predict in METHODS.items():
                predicted = np.maximum(predict(lights[held_out], lights[used], values[held_out]), 0)
                difference = np.linalg.norm(predicted - values[used], axis=1)
                errors[name] += (difference / np.linalg.norm(values[used], axis=1)).tolist()
        yield {"lights": number, **{name: 100 * float(np.mean(e)) for name, e in errors.items()}}


def read_dome(folder: Path) -> tuple[NDArray[np.float32], Double, Bools] | None:
    """Return pictures (L, H, W, C), unit vectors (L, 3) and a mask; None if a folder has none."""
    from rfpipe.pictures.files import natural

    files = [p for p in folder.iterdir() if p.suffix.lower() in (".png", ".jpg", ".tif", ".tga")]
    masks = [file for file in files if "mask" in file.name.lower()]
    files = sorted((f for f in files if f not in masks), key=lambda file: natural(file.name))
    if len(files) < 6:
        return None
    directions = lights_in(folder, [file.name for file in files], parent=True)
    if directions is None or len(directions) != len(files):
        return None
    pictures = np.stack([np.atleast_3d(read_image(file)) for file in files])
    mask = np.ones(pictures.shape[1:3], np.bool_)
    if masks:
        mask = np.atleast_3d(read_image(masks[0])).max(axis=-1) > 0.5
    return pictures, unit(directions), mask
