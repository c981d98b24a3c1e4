"""Shared functions of the scripts: sizes, scenes, acquisitions, and items of the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import CameraModel, acquire
from rfpipe.array_types import Float
from rfpipe.config.scenes import SceneSettings
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

TOLERANCE = 1e-3  # of every acquisition where a script says no other
_SEED = 1
_FILLED = 0.8  # of the full well, at most, by the floodlit picture


@dataclass(frozen=True)
class Size:
    """Size and precision of the figures: `figures/figures.yaml` and `figures_full.yaml`."""

    side: int = 48  # pixels of the square pictures
    samples: int = 4096  # paths of light a pixel
    positions: int = 80  # of the camera on its arc
    sides: tuple[int, ...] = (4, 8, 16, 32, 64)  # of scene IV in Fig. 3.8
    cache: str = "results/recorded"  # folder of recorded matrices

    @property
    def even(self) -> tuple[int, int]:
        """Shape whose pixels are all on the last level of the block tree."""
        side = 2 ** int(np.ceil(np.log2(self.side)))
        return side, side


@dataclass(frozen=True)
class Picture:
    """A figure of the page: written as ``{slug}.png`` and ``{slug}.pdf``."""

    slug: str
    name: str
    thesis: str
    caption: str
    figure: Figure


@dataclass(frozen=True)
class Table:
    """A table of the page: written as ``{slug}.csv``."""

    slug: str
    name: str
    caption: str
    rows: pd.DataFrame


@dataclass(frozen=True)
class Cost:
    """A row of Table 3.1 or 5.1, as measured at this size."""

    table: str
    figure: str
    scene: str
    camera_rays: int
    rays: int
    patterns: int
    pictures: int
    megabytes: float
    processing_s: float
    error: float
    positions: int = 1


Items = Iterator[Picture | Table | Cost]


def physical(size: Size, name: str, **options: Any) -> Any:
    """Return a physically based scene by its name, at the size of the figures."""
    shape = (size.side, size.side)
    given = {"shape": shape, "samples": size.samples, "cache": size.cache, **options}
    return scene_from_config(SceneSettings.of("mitsuba", scene=name, **given))


def aside(size: Size, name: str, right: float = 22.0, up: float = 12.0, **options: Any) -> Any:
    """Return a scene whose projector stands degrees to the right of its camera and above."""
    from rfpipe.mitsuba.worlds import WORLDS

    camera = WORLDS[name].cameras[0]
    views = {"cameras": [camera.model_dump()], "projectors": [turned(camera, right, up)]}
    return physical(size, name, **views, **options)


def turned(view: Any, right: float, up: float) -> dict[str, Any]:
    """Return a pinhole as settings, gone round its target to the right and up, in degrees."""
    target = np.array(view.target)
    upward = np.array(view.up) / np.linalg.norm(view.up)
    out = _rotated(np.array(view.origin) - target, upward, np.radians(right))
    across = np.cross(upward, out)
    out = _rotated(out, across / np.linalg.norm(across), -np.radians(up))
    return {**view.model_dump(), "origin": tuple(map(float, target + out))}


def _rotated(vector: Any, axis: Any, angle: float) -> Any:
    """Turn a vector about a unit axis (Rodrigues)."""
    along = axis * (axis @ vector)
    return along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector)


@dataclass
class Watched:
    """A rig that keeps the patterns of each level, in `levels`."""

    rig: Any
    levels: dict[int, list[Float]] = field(default_factory=dict)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the rig."""
        return getattr(self.rig, name)

    def capture(self, patterns: Float, keys: Sequence[tuple[int, ...]]) -> NDArray[Any]:
        """Show patterns."""
        for pattern, key in zip(patterns, keys, strict=True):
            self.levels.setdefault(key[0], []).append(pattern)
        captured: NDArray[Any] = self.rig.capture(patterns, keys)
        return captured


def acquired(scene: Any, method: str, light: float = 1.0, **options: Any) -> tuple[Any, Watched]:
    """Acquire a scene through a camera; return the result, and the rig.

    Parameters
    ----------
    scene : Scene
    method : str
    light : float
        Factor on the default camera's photons; the aperture is closed so far that the floodlit
        picture isn't saturated.
    **options
        The method's.
    """
    camera = CameraModel()
    floodlit = scene.apply(white(scene.projector_shape).reshape(1, -1))
    brightest = camera.full_well_electrons / camera.exposures[0] / float(floodlit.max())
    electrons = min(light * camera.electrons_per_radiance, _FILLED * brightest)
    rig = Watched(SimulatedRig(scene, replace(camera, electrons_per_radiance=electrons), _SEED))
    return acquire(rig, method, progress=False, **{"tolerance": TOLERANCE, **options}), rig


def white(shape: tuple[int, ...]) -> Float:
    """Return the pattern that lights everything."""
    return np.ones(shape, np.float32)


def matte(shape: tuple[int, ...], period: int = 8) -> Float:
    """Return a high-frequency matte: diagonal stripes, half as wide as `period` pixels."""
    rows, columns = np.indices(shape[-2:])
    stripes = ((rows + columns) % period < period // 2).astype(np.float32)
    return np.broadcast_to(stripes, shape).copy()


def seen(scene: Any, pattern: Float) -> Float:
    """Return the true picture (*camera_shape, C) under a pattern."""
    picture: Float = scene.apply(pattern.reshape(1, -1))[0]
    return picture.reshape(*scene.camera_shape, scene.channels)


def dual_truth(scene: Any, light: Float) -> Float:
    """Return the true dual picture (*projector_shape, C) of a camera-side light (2.12)."""
    lit = np.asarray(light, np.float64).ravel()
    pictures = [scene.dense(channel).T @ lit for channel in range(scene.channels)]
    stacked = np.stack(pictures, axis=-1).astype(np.float32)
    return stacked.reshape(*scene.projector_shape, scene.channels)


def with_errors(levels: Sequence[Any], truth: Any, columns: int = 5) -> list[list[Any]]:
    """Return rows of panels and of their errors below, the truth last without one."""
    panels, rows = [*levels, truth], []
    for first in range(0, len(panels), columns):
        row_panels = panels[first : first + columns]
        errors = [None if panel is truth else panel.less(truth) for panel in row_panels]
        rows += [row_panels, errors] if any(errors) else [row_panels]
    return rows


def level_pictures(result: Any, light: Float) -> list[Float]:
    """Return the contribution of each level to the dual picture."""
    transport = result.transport
    by_level = {pairs.level: pairs for pairs in transport.level_responses}
    pictures = []
    for level in range(transport.last_level + 1):
        level_matrices = [by_level[level]] if level in by_level else []
        single_level = transport.with_content(transport.level_rows, level_matrices)
        pictures.append(single_level.T.relight(light))
    return pictures


def error(image: NDArray[Any], truth: NDArray[Any], where: Any = ...) -> float:
    """Return the relative RMS error of a picture; NaN of a black one."""
    true = np.asarray(truth[where], np.float64)
    scale = np.linalg.norm(true)
    return float(np.linalg.norm(image[where] - true) / scale) if scale > 0 else float("nan")


def percent(value: float) -> str:
    """Return a fraction in per cent."""
    return f"{100 * value:.{0 if abs(value) >= 0.1 else 2}f} %"


def cost(table: str, figure: str, scene: Any, result: Any, error: float, **more: Any) -> Cost:
    """Return a row of Table 3.1 or 5.1."""
    given = {
        "camera_rays": int(np.prod(scene.camera_shape)),
        "rays": int(np.prod(scene.projector_shape)),
        "patterns": result.patterns,
        "pictures": result.pictures,
        "megabytes": result.transport.nbytes / 1e6,
        "processing_s": result.processing_seconds,
        **more,
    }
    return Cost(table, figure, scene.world.name.replace("_", " "), error=error, **given)


def size_of(scene: Any) -> str:
    """Say how large a scene's pictures are, and how exact its ground truth."""
    camera, projector = (
        " x ".join(map(str, shape)) for shape in (scene.camera_shape, scene.projector_shape)
    )
    noise = scene.recording.noise["half_lit"]["whole"]
    return (
        f"Camera {camera}, projector {projector} pixels; the true matrix has {percent(noise)} of "
        "Monte-Carlo noise."
    )


def exposure(*images: NDArray[Any]) -> float:
    """Return the radiance to show as white, so that few pixels of these pictures are cut off."""
    return float(max(np.percentile(image, 99.0) for image in images)) or 1.0
