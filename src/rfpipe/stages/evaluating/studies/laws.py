"""What chapter 2 and Appendix A of the thesis say of any light transport, as measurements."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.stages.evaluating.studies.physical import Arrays, Rows, physical_scene
from rfpipe.stages.evaluating.studies.poses import turned

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["laws_study"]

Double = NDArray[np.float64]

_SHAPE = (24, 28)
_BOUNCES = (1, 2, 3, 4)
_ERRORS = (1e-1, 1e-2, 1e-3)


def laws_study(config: Config) -> tuple[Rows, Arrays]:
    """Measure duality, symmetry, rank, what texture does, and energy.

    Returns
    -------
    rows : list of dict
        ``law``, ``what`` (the case) and ``value``; ``limit`` is what the value is compared with,
        None where there is nothing to compare with.
    arrays : dict of ndarray
        Float32: ``dual_by_transpose`` and ``dual_by_exchange``, pictures (H, W, 3).
    """
    rows, arrays = _duality(config)
    return rows + _symmetry(config) + _ranks(config) + _texture() + _energy(config), arrays


def _duality(config: Config) -> tuple[Rows, Arrays]:
    """Exchange projector and camera: T becomes its transpose [2.12, A]."""
    from rfpipe_mitsuba.worlds import WORLDS

    camera = WORLDS["two_blocks"].cameras[0]
    views = [[asdict(camera)], [turned(camera, 22.0, 12.0)]]
    forth = physical_scene(config, "two_blocks", cameras=views[0], projectors=views[1])
    back = physical_scene(config, "two_blocks", cameras=views[1], projectors=views[0])
    one = np.stack([forth.dense(channel).T for channel in range(3)])
    other = np.stack([back.dense(channel) for channel in range(3)])
    scale = float((one * other).sum() / (other * other).sum())  # brightness is set for each
    pictures = [matrix.sum(axis=2).T.reshape(*forth.projector_shape, 3) for matrix in (one, other)]
    difference = _relative(pictures[0], scale * pictures[1])
    noise = np.hypot(_noise(forth), _noise(back))
    coarse = [_blocks(matrix.sum(axis=0), forth.projector_shape[0]) for matrix in (one, other)]
    rows: Rows = [
        _row("duality", "dual picture: transpose against exchange", difference, float(noise)),
        _row(
            "duality",
            "matrix between blocks of 6 x 6 pixels",
            _relative(coarse[0], scale * coarse[1]),
            float(noise),
        ),
    ]
    return rows, {
        "dual_by_transpose": pictures[0].astype(np.float32),
        "dual_by_exchange": (scale * pictures[1]).astype(np.float32),
    }


def _blocks(matrix: Double, side: int, length: int = 6) -> Double:
    """Return transport between square blocks of two square pictures, 3 or more a side."""
    length = max(d for d in range(1, min(length, side // 3) + 1) if side % d == 0)
    parts = matrix.reshape(side // length, length, side // length, length, -1)
    rows = parts.sum(axis=(1, 3)).reshape(-1, matrix.shape[1])
    columns = rows.T.reshape(side // length, length, side // length, length, -1)
    blocks: Double = columns.sum(axis=(1, 3)).reshape(-1, rows.shape[0])
    return blocks


def _symmetry(config: Config) -> Rows:
    """A coaxial rig's matrix equals its transpose [2.10], traced as though it were not one."""
    from rfpipe_mitsuba.worlds import WORLDS

    rows = []
    for name in ("two_blocks", "glossy_metal"):
        camera = [asdict(WORLDS[name].cameras[0])]
        scene = physical_scene(config, name, cameras=camera, projectors=camera)
        total = sum(scene.dense(channel) for channel in range(3))
        blocks = _blocks(np.asarray(total), scene.camera_shape[0])
        off = blocks - np.diag(np.diag(blocks))
        value = _relative(off, off.T)
        rows.append(
            _row(
                "symmetry", f"{name}: indirect light between blocks", value, _noise(scene, "unlit")
            )
        )
    return rows


def _ranks(config: Config) -> Rows:
    """Blocks between surfaces that exchange light are of low rank [2.3, 5]."""
    from rfpipe.scenes.reference import reference_scene

    rows = []
    for name in ("II", "III", "IV"):
        matrix = reference_scene(name, _SHAPE, channels=1).dense(0)
        rows += _rank_rows(f"scene {name}, plane to plane", _across(matrix, _SHAPE))
    for name in ("red_wall_box", "two_blocks"):
        scene = physical_scene(config, name)
        side = scene.camera_shape[0]
        blocks = _blocks(scene.dense(0), side)  # single entries are noise
        across = _across(blocks, (int(np.sqrt(len(blocks))),) * 2)
        rows += _rank_rows(f"{name}, left to right, between blocks of pixels", across)[:2]
    return rows


def _across(matrix: Double, shape: tuple[int, ...]) -> Double:
    """Return the block of the matrix from the left third of a picture to its right third."""
    columns = np.arange(int(np.prod(shape))) % shape[1]
    return matrix[columns >= 2 * shape[1] // 3][:, columns < shape[1] // 3]


def _rank_rows(what: str, block: Double) -> Rows:
    values = np.linalg.svd(block, compute_uv=False)
    left = np.sqrt(np.cumsum(values[::-1] ** 2)[::-1] / (values**2).sum())
    ranks = {error: int(np.sum(left > error)) for error in _ERRORS}
    told = [
        _row("rank", f"{what}: rank at error {error:g}", rank, min(block.shape))
        for error, rank in ranks.items()
    ]
    return [_row("rank", f"{what}: error of rank 1", float(left[1]), None), *told]


def _texture() -> Rows:
    """Texture scales rows and columns of a block, and changes nothing else [2.2]."""
    from rfpipe.scenes.reference import reference_scene

    white, textured = (
        _across(reference_scene(name, _SHAPE, channels=1, bounces=2).dense(0), _SHAPE)
        for name in ("II", "IV")
    )
    seen = white > 0
    ratio = np.divide(textured, white, out=np.zeros_like(white), where=seen)
    values = np.linalg.svd(ratio, compute_uv=False)
    left = float(np.sqrt((values[1:] ** 2).sum() / (values**2).sum()))
    return [_row("texture", "scene IV over scene II, plane to plane: error of rank 1", left, 1e-5)]


def _energy(config: Config) -> Rows:
    """Each further bounce adds light, and less than the one before it [2.7]."""
    scenes = [physical_scene(config, "red_wall_box", bounces=count) for count in _BOUNCES]
    light = [float(sum(scene.dense(channel).sum() for channel in range(3))) for scene in scenes]
    added = np.diff(light) / light[0]
    rows = [
        _row("energy", f"light that bounce {count} adds, of the direct light", float(share), limit)
        for count, share, limit in zip(_BOUNCES[1:], added, [1.0, *added], strict=False)
    ]
    least = min(float(scene.dense(0).min()) for scene in scenes[-1:])
    return [*rows, _row("energy", "least entry of T", least, 0.0)]


def _noise(scene: Any, part: str = "whole") -> float:
    """Relative noise of a half-lit picture."""
    return float(scene.recording.noise["half_lit"][part])


def _relative(one: Double, other: Double) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def _row(law: str, what: str, value: float, limit: float | None) -> dict[str, Any]:
    return {"law": law, "what": what, "value": float(value), "limit": limit}
