"""Errors of relightable images of museum viewers, at lights that were left out of them.

The decoders follow the viewers' published formulas and share nothing with
`rfpipe.export.relightable_images`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from benchmarks.photographs.domes import read_dome
from benchmarks.photographs.simulated import DOMES, OBJECTS, simulated_dome
from rfpipe.array_types import Double, Float
from rfpipe.export import write_relightable_image
from rfpipe.pictures.images import read_image, srgb
from rfpipe.transport.dense import DenseTransport

_HORIZON = 0.15
"""Elevation, radians, below which OpenLIME doesn't evaluate hemispherical harmonics."""


def decode_folder(folder: Path, direction: Double) -> Double:
    """Return the colours (H, W, 3), sRGB, that OpenLIME shows under light from a unit vector."""
    info = json.loads((folder / "info.json").read_text())
    assert (info["type"], info["colorspace"]) == ("bilinear", "mrgb")
    side, count, material = info["resolution"], info["nplanes"], info["materials"][0]
    names = [folder / f"plane_{index}.jpg" for index in range(count // 3)]
    codes = np.concatenate([read_image(name) for name in names], axis=-1)
    coefficients = (codes - np.array(material["bias"])) * np.array(material["scale"])
    table = np.array(info["basis"], np.float64).reshape(count + 1, side, side, 3)
    table[1:] = (table[1:] - 127) / np.array(material["range"])[:, None, None, None]
    table[0] /= 255
    x, y, _ = direction / np.abs(direction).sum()
    place = (np.array([y - x, x + y]) + 1) / 2 * (side - 1)
    row, column = np.clip(place.astype(int), 0, side - 2)
    down, right = place - (row, column)
    above = (1 - right) * table[:, row, column] + right * table[:, row, column + 1]
    below = (1 - right) * table[:, row + 1, column] + right * table[:, row + 1, column + 1]
    mean, *basis = (1 - down) * above + down * below
    colours: Double = mean + coefficients @ np.array(basis)
    return np.clip(colours, 0, 1)


def decode_ptm(file: Path, direction: Double) -> Double:
    """Return the colours (H, W, 3), sRGB, that RTIViewer shows under light from a unit vector."""
    version, kind, *rest = file.read_bytes().split(b"\n", 6)
    assert (version, kind) == (b"PTM_1.2", b"PTM_FORMAT_RGB")
    width, height = map(int, rest[:2])
    scale, bias = (np.array(line.split(), np.float64) for line in rest[2:4])
    codes = np.frombuffer(rest[4], np.uint8).reshape(3, height, width, 6)[:, ::-1]
    u, v, _ = direction
    functions = np.array([u * u, v * v, u * v, u, v, 1])
    colours: Double = np.moveaxis(((codes - bias) * scale) @ functions / 255, 0, -1)
    return np.clip(colours, 0, 1)


def harmonics(directions: Double) -> Double:
    """Return the hemispherical harmonics of the second order, shape (D, 9)."""
    turn = np.arctan2(directions[:, 1], directions[:, 0])
    c = np.maximum(directions[:, 2], np.sin(_HORIZON))
    root, middle = np.sqrt(np.maximum(c - c * c, 0)), 2 * c - 1
    columns = [np.ones_like(c), root * np.cos(turn), middle, root * np.sin(turn)]
    columns += [root**2 * np.cos(2 * turn), middle * root * np.cos(turn), 1 - 6 * root**2]
    columns += [middle * root * np.sin(turn), root**2 * np.sin(2 * turn)]
    return np.stack(columns, axis=1)


def by_harmonics(lights: Double, colours: Double, directions: Double) -> Double:
    """Fit harmonics to colours (L, H, W, 3); round them to 8 bits; evaluate them at directions."""
    functions = harmonics(lights)
    moments = functions.T @ functions + 1e-4 * len(lights) * np.eye(9)
    coefficients = np.linalg.solve(moments, functions.T @ colours.reshape(len(lights), -1))
    planes = coefficients.reshape(9, -1, 3)
    low = planes.min(axis=1, keepdims=True)
    step = np.maximum(planes.max(axis=1, keepdims=True) - low, 1e-9) / 255
    rounded = (np.rint((planes - low) / step) * step + low).reshape(9, -1)
    shown = (harmonics(directions) @ rounded).reshape(len(directions), *colours.shape[1:])
    return np.clip(shown, 0, 1)


def relightable_rows(
    pictures: Float, directions: Double, held_out: Iterable[NDArray[np.intp]]
) -> dict[str, float]:
    """Return errors at held-out lights, percent of the norm in sRGB, mean over them.

    Parameters
    ----------
    pictures : ndarray, shape (L, H, W, 3)
    directions : ndarray, shape (L, 3)
        Unit vectors.
    held_out : iterable of ndarray of int
        Lights that are left out at a time.
    """
    errors: dict[str, list[float]] = {}
    size = pictures.shape[1:3]
    for lights in held_out:
        used = np.setdiff1d(np.arange(len(pictures)), lights)
        matrix = np.ascontiguousarray(pictures[used].reshape(len(used), -1, 3).T)
        transport = DenseTransport(size, (1, len(used)), 3, [], {"matrix": matrix})
        transport.lights = directions[used]
        towards = directions[lights]
        with TemporaryDirectory() as folder:
            web, ptm = Path(folder, "web"), Path(folder, "dome.ptm")
            white = write_relightable_image(transport, web).white
            write_relightable_image(transport, ptm)
            shown = {
                "PTM": [decode_ptm(ptm, d) for d in towards],
                "HSH": by_harmonics(directions[used], srgb(pictures[used], white), towards),
                "rfpipe, folder": [decode_folder(web, d) for d in towards],
                "rfpipe, light_from": [srgb(transport.light_from(d), white) for d in towards],
            }
        truth = srgb(pictures[lights], white)
        for name, images in shown.items():
            pairs = zip(images, truth, strict=True)
            errors.setdefault(name, []).extend(
                float(np.linalg.norm(image - true) / np.linalg.norm(true)) for image, true in pairs
            )
    return {name: 100 * float(np.mean(values)) for name, values in errors.items()}


def relightable_table(psm: Path | None, seeds: range, side: int = 96) -> pd.DataFrame:
    """Return the errors of the objects in a folder, and of simulated ones, each with 48 lights."""
    rows = []
    for place in sorted(psm.iterdir()) if psm else ():
        dome = read_dome(place) if place.is_dir() else None
        if dome is not None:
            pictures, directions, mask = dome
            box = np.ix_(range(len(pictures)), mask.any(axis=1), mask.any(axis=0), range(3))
            folds = np.arange(len(pictures))[::3, None]
            errors = relightable_rows((pictures * mask[..., None])[box], directions, folds)
            rows.append({"object": place.name, "lights": len(pictures) - 1, **errors})
    for seed in seeds:
        kind, arrangement = OBJECTS[seed % len(OBJECTS)], DOMES[1:][seed % 3]
        values, directions = simulated_dome(kind, arrangement, seed, 0.05, side)
        height = values.shape[2] // side
        pictures = np.moveaxis(values[..., : height * side], 1, -1)
        order = np.random.default_rng(0).permutation(len(pictures))
        image = pictures.reshape(len(pictures), height, side, 3)
        errors = relightable_rows(image, directions, [order[48:]])
        rows.append({"object": f"{kind}, {arrangement}", "lights": 48, **errors})
    return pd.DataFrame(rows)
