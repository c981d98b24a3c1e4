"""Fig. 2.2, chapter 2 and Appendix A: what holds of any light transport, measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from figures.common import Items, Picture, Size, Table, error, exposure, physical, turned
from rfpipe.array_types import Double
from rfpipe.report.drawing import Panel, difference, draw
from rfpipe.scenes import reference_scene

_SHAPE = (24, 28)
_BOUNCES = (1, 2, 3, 4)
_ERRORS = (1e-1, 1e-2, 1e-3)


def items(size: Size) -> Items:
    """Measure duality, symmetry, rank, what texture does, and energy."""
    transposed, exchanged, rows = _duality(size)
    rows += [*_symmetry(size), *_ranks(size), *_texture(), *_energy(size)]
    bright = exposure(transposed, exchanged)
    panels = [
        Panel(transposed, "transposed matrix", "", bright),
        Panel(exchanged, "projector and camera exchanged", "", bright),
        difference(transposed, exchanged, bright),
    ]
    caption = (
        "The dual picture of a box with two blocks, twice: by the transposed matrix, and by one "
        "recorded with projector and camera exchanged, with other random numbers."
    )
    thesis = "exchanging projector and camera transposes the matrix."
    yield Picture("fig_2_2", "Fig. 2.2, duality", thesis, caption, draw([panels]))
    caption = (
        "Each number has its reference beside it: for duality and symmetry the noise of the "
        "recordings, for ranks the size of the block, for energy the previous bounce."
    )
    table = pd.DataFrame(rows, columns=["law", "measured", "value", "compared_with"])
    yield Table("laws", "The laws of light transport (chapter 2, Appendix A)", caption, table)


def _duality(size: Size) -> tuple[Double, Double, list[Any]]:
    """Exchange projector and camera: T becomes its transpose [2.12, A]."""
    from rfpipe.mitsuba.worlds import WORLDS

    camera = WORLDS["two_blocks"].cameras[0]
    views = [[camera.model_dump()], [turned(camera, 22.0, 12.0)]]
    forth = physical(size, "two_blocks", cameras=views[0], projectors=views[1])
    reverse = physical(size, "two_blocks", cameras=views[1], projectors=views[0])
    transposed = np.stack([forth.dense(channel).T for channel in range(3)])
    exchanged = np.stack([reverse.dense(channel) for channel in range(3)])
    exchanged = exchanged * float(
        (transposed * exchanged).sum() / (exchanged * exchanged).sum()
    )  # each has its brightness
    pictures = [
        matrix.sum(axis=2).T.reshape(*forth.projector_shape, 3)
        for matrix in (transposed, exchanged)
    ]
    noise = float(np.hypot(_noise(forth), _noise(reverse)))
    coarse = [
        _blocks(matrix.sum(axis=0), forth.projector_shape[0]) for matrix in (transposed, exchanged)
    ]
    rows = [
        ("duality", "dual picture: transpose against exchange", error(*pictures), noise),
        ("duality", "matrix between blocks of 6 x 6 pixels", error(*coarse), noise),
    ]
    return pictures[0], pictures[1], rows


def _blocks(matrix: Double, side: int, length: int = 6) -> Double:
    """Return transport between square blocks of two square pictures, 3 or more a side."""
    length = max(d for d in range(1, min(length, side // 3) + 1) if side % d == 0)
    parts = matrix.reshape(side // length, length, side // length, length, -1)
    rows = parts.sum(axis=(1, 3)).reshape(-1, matrix.shape[1])
    columns = rows.T.reshape(side // length, length, side // length, length, -1)
    blocks: Double = columns.sum(axis=(1, 3)).reshape(-1, rows.shape[0])
    return blocks


def _symmetry(size: Size) -> list[Any]:
    """A coaxial rig's matrix equals its transpose [2.10], traced as though it were not one."""
    from rfpipe.mitsuba.worlds import WORLDS

    rows = []
    for name in ("two_blocks", "glossy_metal"):
        camera = [WORLDS[name].cameras[0].model_dump()]
        scene = physical(size, name, cameras=camera, projectors=camera)
        blocks = _blocks(sum(scene.dense(channel) for channel in range(3)), scene.camera_shape[0])
        aside = blocks - np.diag(np.diag(blocks))
        what = f"{name}: indirect light between blocks"
        rows.append(("symmetry", what, error(aside, aside.T), _noise(scene, "unlit")))
    return rows


def _ranks(size: Size) -> list[Any]:
    """Blocks between surfaces that exchange light are of low rank [2.3, 5]."""
    rows = []
    for name in ("II", "III", "IV"):
        matrix = reference_scene(name, _SHAPE, channels=1).dense(0)
        rows += _rank_rows(f"scene {name}, plane to plane", _across(matrix, _SHAPE))
    for name in ("red_wall_box", "two_blocks"):
        scene = physical(size, name)
        blocks = _blocks(scene.dense(0), scene.camera_shape[0])  # single entries are noise
        across = _across(blocks, (int(np.sqrt(len(blocks))),) * 2)
        rows += _rank_rows(f"{name}, left to right, between blocks of pixels", across)[:2]
    return rows


def _across(matrix: Double, shape: tuple[int, ...]) -> Double:
    """Return the block of the matrix from the left third of a picture to its right third."""
    columns = np.arange(int(np.prod(shape))) % shape[1]
    return matrix[columns >= 2 * shape[1] // 3][:, columns < shape[1] // 3]


def _rank_rows(what: str, block: Double) -> list[Any]:
    values = np.linalg.svd(block, compute_uv=False)
    beyond = np.sqrt(np.cumsum(values[::-1] ** 2)[::-1] / (values**2).sum())
    ranks = [
        ("rank", f"{what}: rank at error {limit:g}", int(np.sum(beyond > limit)), min(block.shape))
        for limit in _ERRORS
    ]
    return [("rank", f"{what}: error of rank 1", float(beyond[1]), None), *ranks]


def _texture() -> list[Any]:
    """Texture scales rows and columns of a block, and changes nothing else [2.2]."""
    plain, textured = (
        _across(reference_scene(name, _SHAPE, channels=1, bounces=2).dense(0), _SHAPE)
        for name in ("II", "IV")
    )
    ratio = np.divide(textured, plain, out=np.zeros_like(plain), where=plain > 0)
    what = "scene IV over scene II, plane to plane: error of rank 1"
    return [("texture", what, _rank_rows("", ratio)[0][2], 1e-5)]


def _energy(size: Size) -> list[Any]:
    """Each further bounce adds light, and less than the one before it [2.7]."""
    scenes = [physical(size, "red_wall_box", bounces=count) for count in _BOUNCES]
    light = [float(sum(scene.dense(channel).sum() for channel in range(3))) for scene in scenes]
    added = [float(share) for share in np.diff(light) / light[0]]
    rows = [
        ("energy", f"light that bounce {count} adds, of the direct light", share, limit)
        for count, share, limit in zip(_BOUNCES[1:], added, [1.0, *added], strict=False)
    ]
    return [*rows, ("energy", "least entry of T", float(scenes[-1].dense(0).min()), 0.0)]


def _noise(scene: Any, part: str = "whole") -> float:
    """Relative noise of a half-lit picture."""
    return float(scene.recording.noise["half_lit"][part])
