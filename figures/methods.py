"""Pictures of docs/methods: ``python -m figures.methods docs/images``."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe import CameraModel, acquire
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.config import SceneSettings
from rfpipe.methods.hadamard import s_matrix_order, s_matrix_row
from rfpipe.methods.multiplexed.blocks import BlockLevels
from rfpipe.methods.multiplexed.method import MultiplexedOptions, pattern_count
from rfpipe.methods.multiplexed.patterns import first_patterns, further_patterns
from rfpipe.pictures.images import srgb
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import scene_from_config
from rfpipe.store.files import write_atomically
from rfpipe.transport import Transport

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SURFACES = ["white", "texture"]


def scans() -> Figure:
    """Draw three patterns of brute force and of Hadamard multiplexing."""
    shape, shown = (16, 16), (5, 6, 120)
    rays = shape[0] * shape[1]
    code = s_matrix_row(s_matrix_order(rays))
    single = [np.eye(1, rays, index) for index in shown]
    coded = [np.roll(code, -index)[:rays] for index in shown]
    images = [[pattern.reshape(shape) for pattern in patterns] for patterns in (single, coded)]
    return _drawn(images, [f"pattern {index}" for index in shown], ["brute force", "Hadamard"])


def dual() -> Figure:
    """Draw the light that one camera pixel receives, resolved by the levels of dual photography."""
    scene = _wedge(projector={"position": (1.72, 0.0, 0.54), "look_at": (0.0, 0.0, 3.0)})
    transport = _acquired(scene, "dual")
    height, width = transport.camera_shape[:2]
    pixel = (height // 2) * width + width // 3
    levels = list(transport.known_levels)[1:]
    rows = [transport.truncate(level).toarray(rows=[pixel]) for level in levels]
    images = [_logarithmic(_grey(row).reshape(transport.projector_shape)) for row in rows]
    return _drawn([images], [f"level {level}" for level in levels])


def multiplexed() -> Figure:
    """Draw a pattern of each level of multiplexed dual photography, and of a further round."""
    levels, last = BlockLevels(RayDomain((48, 48))), -1
    captions, images = [], []
    for index, level in enumerate(levels.levels):
        count = pattern_count(index, len(levels), MultiplexedOptions().tolerance)
        lit = first_patterns(levels, index, 1 + index, count)
        images.append(levels.patterns(index, lit)[last])
        captions.append(f"{levels.tree.n_blocks(level):,} blocks")
    lit = further_patterns(levels, len(levels) - 1, 1 + len(levels), 6)
    images.append(levels.patterns(len(levels) - 1, lit)[last])
    return _drawn([images], [*captions, "a further round"])


def symmetric() -> Figure:
    """Draw the matrix of scene III in the order of the block tree, level by level."""
    scene = _wedge(shape=(16, 16))
    transport = _acquired(scene, "symmetric", tolerance=3e-3)
    order = BlockTree(RayDomain((16, 16))).order
    levels = [2, 3, 4]
    images = [
        _logarithmic(_grey(transport.truncate(level).toarray())[np.ix_(order, order)])
        for level in levels
    ]
    return _drawn([images], [f"known after level {level}" for level in levels])


def near_far() -> Figure:
    """Draw a room under floodlight, its direct light, and its indirect light from near and far."""
    shape = (72, 81)
    scene = scene_from_config(SceneSettings.of("coloured_room", shape=shape))
    transport = _acquired(scene, "near_far", target_error=0.01)
    white = np.ones(shape, np.float32)
    parts = transport.separate(white)
    floodlit, brightest = transport.relight(white), float(np.percentile(parts.direct, 99))
    images = [
        srgb(floodlit, brightest),
        srgb(parts.direct, brightest),
        srgb(parts.near, brightest / 4),
        srgb(parts.far, brightest / 4),
    ]
    titles = ["floodlit", "direct", "indirect, near (4 x)", "indirect, far (4 x)"]
    return _drawn([images], titles)


def footprints() -> Figure:
    """Draw the place of each camera pixel's footprint on the projector."""
    scene = _wedge(projector={"position": (1.72, 0.0, 0.54), "look_at": (0.0, 0.0, 3.0)})
    transport = _acquired(scene, "footprints", target_error=0.01)
    matches = transport.correspondence()
    floodlit = transport.relight(np.ones(transport.projector_shape, np.float32))
    column, row = (np.where(matches.mask, matches.places[..., axis], np.nan) for axis in (1, 0))
    images = [srgb(floodlit, float(floodlit.max())), column, row]
    titles = ["floodlit", "column on the projector", "row on the projector"]
    return _drawn([images], titles, colours="viridis")


def _wedge(shape: tuple[int, int] = (48, 48), **settings: Any) -> Any:
    options = {"surfaces": _SURFACES, "shape": shape, "channels": 1, **settings}
    return scene_from_config(SceneSettings.of("wedge_120", **options))


def _acquired(scene: Any, method: str, **options: Any) -> Transport:
    rig = SimulatedRig(scene, CameraModel(), seed=1)
    return acquire(rig, method, progress=False, **options).transport


def _grey(matrix: NDArray[Any]) -> NDArray[Any]:
    """Return the first channel of matrices (C, M, N) or of a matrix (M, N)."""
    return matrix[0] if matrix.ndim == 3 else matrix


def _logarithmic(light: NDArray[Any]) -> NDArray[Any]:
    """Return the decimal logarithm of light over its maximum, at least -5."""
    return np.log10(np.maximum(light / light.max(), 1e-5))


def _drawn(
    rows: list[list[NDArray[Any]]],
    titles: list[str],
    labels: list[str] | None = None,
    colours: str = "gray",
) -> Figure:
    """Draw images in rows."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.2 * len(titles), 2.3 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), len(titles), squeeze=False)
    for line, images in zip(axes, rows, strict=True):
        for panel, image, title in zip(line, images, titles, strict=True):
            panel.imshow(image, cmap=colours, interpolation="nearest")
            panel.set(xticks=[], yticks=[])
            panel.set_title(title, fontsize=9)
    for line, label in zip(axes, labels or [], strict=False):
        line[0].set_ylabel(label, fontsize=9)
    return figure


def main(folder: str) -> None:
    """Write all pictures into a folder."""
    for draw in (scans, dual, multiplexed, symmetric, near_far, footprints):
        image = io.BytesIO()
        draw().savefig(image, format="png", dpi=110)
        write_atomically(Path(folder) / f"method_{draw.__name__}.png", image.getvalue())


if __name__ == "__main__":
    main(sys.argv[1])
