"""Dual photography's pictures on physically based scenes [thesis Fig. 3.1 to 3.7, 3.10]."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.evaluating.studies.physical import (
    Arrays,
    Rows,
    acquired,
    cost,
    dual_truth,
    even_shape,
    matte,
    physical_scene,
    white,
)
from rfpipe.stages.evaluating.studies.poses import aside

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.stages.acquire import AcquisitionResult
    from rfpipe.transport.multilevel.transport import MultilevelTransport
    from rfpipe_mitsuba.scene import MitsubaScene

__all__ = ["bottle_study", "box_study", "right_angles_study", "samples_study", "walk_study"]

Float = NDArray[np.float32]

_DIM = 0.1  # of the run's light, at which single pixels' inter-reflections sink into noise
_MANY = 4.0  # times the camera pixels that a median projector pixel lights
_LEAST_LIT = 0.01  # of the light of the projector pixel that most comes back from
_COARSE = 3e-2  # tolerance of the patterns shown
_TO_THE_PIXEL = 1e-9  # tolerance at which nothing is stored at a coarse level but noise


def walk_study(_config: Config) -> tuple[Rows, Arrays]:
    """Show an 8 x 8 projector's patterns without and with conflicts [Fig. 3.1].

    Returns
    -------
    rows : list of dict
        ``case`` ("without", "with"), ``patterns``.
    arrays : dict of ndarray
        ``{case}_{level}``: int64 (8, 8), the number of the frame that lights each pixel.
    """
    from rfpipe.rigs import OperatorRig
    from rfpipe.stages.acquire import acquire

    rows: Rows = []
    arrays: Arrays = {}
    for case in ("without", "with"):
        shown: dict[int, list[Float]] = {}

        class Rig(OperatorRig):
            def capture(self, patterns: Float, keys: Any) -> NDArray[Any]:
                for pattern, key in zip(patterns, keys, strict=True):
                    shown.setdefault(key[0], []).append(pattern)  # noqa: B023
                return super().capture(patterns, keys)

        rig = Rig(_walk_matrix(conflicts=case == "with"), (6, 11), (8, 8))
        result = acquire(rig, "dual", progress=False)
        frame = 0
        for level in range(4):
            numbers = np.zeros((8, 8), np.int64)
            for pattern in shown[level]:
                frame += 1
                numbers[pattern > 0] = frame
            arrays[f"{case}_{level}"] = numbers
        rows.append({"case": case, "patterns": result.patterns})
    return rows, arrays


def _walk_matrix(*, conflicts: bool) -> NDArray[np.float64]:
    """Transport (66, 64): a ray a pixel, and two pixels that see rays of blocks 2 and 4."""
    matrix = np.zeros((66, 64))
    matrix[:64] = np.eye(64)
    if conflicts:
        for pixel, rays in ((64, ((0, 0), (6, 6))), (65, ((2, 2), (4, 4)))):
            for row, column in rays:
                matrix[pixel, 8 * row + column] = 0.5
    return matrix


def box_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire a box with coloured walls down to the pixel, and with a hierarchy [Fig. 3.3, 3.4].

    The camera gets a tenth of the run's light, so that what one projector pixel sends by way of a
    wall is lost in noise, as in the thesis.

    Returns
    -------
    rows : list of dict
        A row of Table 3.1 for either, ``kept``: the inter-reflected light in the dual picture, as
        a fraction of the true one, and ``levels``: patterns of each level.
    arrays : dict of ndarray
        Float32 (H, W, 3): ``primal``, ``dual_truth``, ``dual_hierarchy``, ``dual_pixel``, and
        ``level_{k}``, what the hierarchy's level k adds to the dual picture.
    """
    shape = even_shape(config)
    scene = aside(config, "two_blocks", shape=shape)
    direct = aside(config, "two_blocks", bounces=1, shape=shape)
    light, floodlit = white(scene.camera_shape), white(scene.projector_shape)
    truth, direct_truth = dual_truth(scene, light), dual_truth(direct, light)
    arrays: Arrays = {"primal": _primal(scene, floodlit), "dual_truth": truth}
    rows: Rows = []
    for case, tolerance in (("pixel", _TO_THE_PIXEL), ("hierarchy", None)):
        options = {} if tolerance is None else {"tolerance": tolerance}
        result, _ = acquired(config, scene, "dual", light=_DIM, **options)
        parts = level_pictures(result, light)
        dual = parts[-1] if case == "pixel" else sum(parts[1:], parts[0])
        arrays[f"dual_{case}"] = dual
        if case == "hierarchy":
            arrays |= {f"level_{level}": part for level, part in enumerate(parts)}
        kept = (dual - direct_truth).sum(dtype=float) / (truth - direct_truth).sum(dtype=float)
        rows.append(
            cost(
                "3.1" if case == "hierarchy" else "",
                "Fig. 3.4, box",
                scene,
                result,
                (dual, truth),
                case=case,
                kept=float(kept),
                levels=[int(count) for count in result.levels["patterns"]],
            )
        )
    return rows, arrays


def level_pictures(result: AcquisitionResult, light: Float) -> list[Float]:
    """Return what each level of a dual acquisition adds to the picture under camera-side light."""
    transport: MultilevelTransport = result.transport  # type: ignore[assignment]
    camera = RayDomain(transport.camera_shape)
    by_level = {pairs.level: pairs for pairs in transport.pair_sets}
    black = np.zeros((*transport.projector_shape, transport.channels), np.float32)
    pictures = []
    for level in range(transport.last_level + 1):
        if level not in by_level:
            pictures.append(black)
            continue
        alone = transport.from_pair_sets(
            camera,
            transport.tree.domain,
            transport.channels,
            transport.level_rows,
            [by_level[level]],
            transport.symmetric,
        )
        pictures.append(alone.T.relight(light))
    return pictures


def _primal(scene: MitsubaScene, pattern: Float) -> Float:
    """Return the true picture (*camera_shape, C) under a pattern."""
    picture: Float = scene.apply(pattern[None])[0]
    return picture.reshape(*scene.camera_shape, scene.channels)


def bottle_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire glass that throws caustics, and relight it by a fine matte [Fig. 3.2, 3.6].

    Returns
    -------
    rows : list of dict
        The row of Table 3.1; ``dual_matte_error`` and ``primal_matte_relit_error``: relative RMS
        errors of pictures relit by the matte; ``coarse``: the fraction of the dual picture's light
        that is stored above the last level; ``together_at_glass`` and ``together_elsewhere``:
        pixels lit together at the last level, where light is spread over much of the picture and
        where not.
    arrays : dict of ndarray
        Float32 (H, W, 3): ``primal``; ``primal_relit``, ``primal_matte_relit``, ``dual`` and
        ``dual_matte`` and the truth of each, ``{name}_truth``; ``pattern``, the one that lights
        most pixels, and ``together`` (projector_shape); ``pattern_seen``.
    """
    scene = physical_scene(config, "bottle", shape=even_shape(config))
    return _pictures(config, scene, "Fig. 3.6, bottle", adapting=True)


def samples_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire two more scenes from aside [Fig. 3.7]; rows and pictures as `bottle_study`."""
    rows: Rows = []
    arrays: Arrays = {}
    for place, world, pose in (
        ("top", "glossy_metal", (22.0, 12.0)),
        ("bottom", "foreshortened", (-8.0, 14.0)),
    ):
        scene = aside(config, world, *pose)
        own, pictures = _pictures(config, scene, f"Fig. 3.7, {place}")
        rows += own
        arrays |= {f"{place}_{name}": picture for name, picture in pictures.items()}
    return rows, arrays


def right_angles_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire a scene with a mirror, camera and projector at right angles [Fig. 3.10].

    Returns
    -------
    rows : list of dict
        As of `bottle_study`, without those on pixels lit together.
    arrays : dict of ndarray
        As of `bottle_study`.
    """
    scene = physical_scene(config, "right_angles")
    return _pictures(config, scene, "Fig. 3.10")


def _pictures(
    config: Config, scene: MitsubaScene, figure: str, *, adapting: bool = False
) -> tuple[Rows, Arrays]:
    """Acquire a scene; primal and dual pictures, floodlit and by a matte, with the truth."""
    result, _ = acquired(config, scene, "dual")
    seen, thrown = white(scene.camera_shape), white(scene.projector_shape)
    transport = result.transport
    arrays: Arrays = {"primal": _primal(scene, thrown)}
    for name, camera, projector in (
        ("", seen, thrown),
        ("_matte", matte(scene.camera_shape), matte(scene.projector_shape)),
    ):
        arrays[f"dual{name}"] = transport.T.relight(camera)
        arrays[f"dual{name}_truth"] = dual_truth(scene, camera)
        arrays[f"primal{name}_relit"] = transport.relight(projector)
        arrays[f"primal{name}_truth"] = _primal(scene, projector)
    parts = level_pictures(result, seen)
    more: dict[str, Any] = {
        f"{name}_error": relative_rms(arrays[name], arrays[truth])
        for name, truth in (
            ("dual_matte", "dual_matte_truth"),
            ("primal_matte_relit", "primal_matte_truth"),
        )
    }
    total = sum(float(part.sum(dtype=float)) for part in parts)
    more["coarse"] = 1 - float(parts[-1].sum(dtype=float)) / total
    if adapting:
        # what the thesis' camera could tell from its noise is some hundredths, not a thousandth
        _, rig = acquired(config, scene, "dual", tolerance=_COARSE)
        lit = [float(pattern.mean()) for pattern in rig.levels[transport.last_level]]
        chosen = rig.levels[transport.last_level][int(np.argmax(lit))]
        arrays["pattern"] = chosen
        arrays["pattern_seen"] = _primal(scene, chosen)
        arrays["together"] = _together(rig.levels[transport.last_level])
        lights, spreads = _spread(scene)
        more["together_at_glass"] = float(arrays["together"][lights & spreads].mean())
        more["together_elsewhere"] = float(arrays["together"][lights & ~spreads].mean())
    images = arrays["dual"], arrays["dual_truth"]
    table = "3.1" if "10" not in figure else ""
    return [cost(table, figure, scene, result, images, **more)], arrays


def _spread(scene: MitsubaScene) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which projector pixels light anything, and which light much more than the median one."""
    light = np.sum([scene.dense(channel) for channel in range(scene.channels)], axis=0)
    total = light.sum(axis=0)
    lights = total > _LEAST_LIT * total.max()
    seen = total**2 / np.maximum(np.square(light).sum(axis=0), np.finfo(float).tiny)
    spreads = seen > _MANY * np.median(seen[lights])
    shape = scene.projector_shape
    return lights.reshape(shape), spreads.reshape(shape)


def _together(patterns: list[Float]) -> Float:
    """Return for each projector pixel how many others were lit with it at the last level."""
    together = np.zeros(patterns[0].shape, np.float32)
    for pattern in patterns:
        together[pattern > 0] = float((pattern > 0).sum())
    return together
