"""What the studies of physically based scenes share: scenes, rigs that remember, dual pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry import sensor_from_config
from rfpipe.rigs import SimulatedRig
from rfpipe.stages.evaluating.metrics import relative_rms

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.stages.acquire import AcquisitionResult
    from rfpipe_mitsuba.scene import MitsubaScene

__all__ = [
    "Arrays",
    "Rows",
    "WatchedRig",
    "acquired",
    "cost",
    "dual_truth",
    "even_shape",
    "matte",
    "physical_scene",
    "white",
]

Float = NDArray[np.float32]
Rows = list[dict[str, Any]]
Arrays = dict[str, NDArray[Any]]

_FILLED = 0.8  # of the full well, at most, by the floodlit picture


def physical_scene(config: Config, name: str, **changes: Any) -> MitsubaScene:
    """Return one of `rfpipe_mitsuba.worlds.WORLDS` at the size of the figures.

    Parameters
    ----------
    config : Config
        Its ``report.figures`` says how large and how exact.
    name : str
    **changes
        Other options of `rfpipe_mitsuba.kind.MitsubaOptions`.
    """
    from rfpipe.config.figures import FiguresConfig
    from rfpipe_mitsuba.kind import Mitsuba, MitsubaOptions

    asked = config.report.figures or FiguresConfig()
    options = {
        "shape": (asked.side, asked.side),
        "samples": asked.samples,
        "cache": asked.cache,
        **changes,
    }
    made = Mitsuba.make(MitsubaOptions(kind="mitsuba", scene=name, **options))
    return cast("MitsubaScene", made)


def even_shape(config: Config) -> tuple[int, int]:
    """Return the size of the figures or more, so that all pixels stand at the tree's last level."""
    from rfpipe.config.figures import FiguresConfig

    asked = config.report.figures or FiguresConfig()
    side = 2 ** int(np.ceil(np.log2(asked.side)))
    return side, side


class WatchedRig(SimulatedRig):
    """A simulated rig that remembers the patterns of each level, in `levels`."""

    def __init__(self, scene: Any, *arguments: Any) -> None:
        super().__init__(scene, *arguments)
        self.levels: dict[int, list[Float]] = {}

    def capture(self, patterns: Float, keys: Sequence[tuple[int, ...]]) -> NDArray[Any]:
        """Show patterns, as `SimulatedRig` does."""
        for pattern, key in zip(patterns, keys, strict=True):
            self.levels.setdefault(key[0], []).append(pattern)
        return super().capture(patterns, keys)


def acquired(
    config: Config, scene: Any, method: str, *, light: float = 1.0, **options: Any
) -> tuple[AcquisitionResult, WatchedRig]:
    """Acquire a scene with the run's camera, as the run's section of the method asks for.

    Parameters
    ----------
    config : Config
    scene : Scene
    method : str
    light : float
        Factor on the photons that the run's camera gets; its aperture is closed so far that the
        floodlit picture isn't saturated.
    **options
        The method's, in place of those of the run.
    """
    from rfpipe.stages.acquire import acquire
    from rfpipe.stages.settings import acquire_options

    camera = config.camera
    if camera is not None:
        floodlit = white(scene.projector_shape).reshape(1, -1)
        brightest = camera.full_well_electrons / camera.exposures[0] / scene.apply(floodlit).max()
        electrons = min(light * camera.electrons_per_radiance, _FILLED * float(brightest))
        camera = camera.model_copy(update={"electrons_per_radiance": electrons})
    rig = WatchedRig(scene, sensor_from_config(camera), config.seed)
    section = config.methods.get(method)
    asked = acquire_options(config, method, section) if section else {"method": method}
    return acquire(rig, progress=False, **{**asked, **options}), rig


def white(shape: tuple[int, ...]) -> Float:
    """Return the pattern that lights everything."""
    return np.ones(shape, np.float32)


def matte(shape: tuple[int, ...], period: int = 8) -> Float:
    """Return a high-frequency matte: diagonal stripes, half as wide as `period` pixels."""
    rows, columns = np.indices(shape[-2:])
    stripes = ((rows + columns) % period < period // 2).astype(np.float32)
    return np.broadcast_to(stripes, shape).copy()


def dual_truth(scene: MitsubaScene, image: Float) -> Float:
    """Return the true dual picture (*projector_shape, C) of a camera-side light (2.12)."""
    lit = np.asarray(image, np.float64).ravel()
    seen = [scene.dense(channel).T @ lit for channel in range(scene.channels)]
    picture = np.stack(seen, axis=-1).reshape(*scene.projector_shape, scene.channels)
    return picture.astype(np.float32)


def cost(
    table: str,
    figure: str,
    scene: MitsubaScene,
    result: AcquisitionResult,
    images: tuple[Float, Float],
    **more: Any,
) -> dict[str, Any]:
    """Return a row of Table 3.1 or 5.1, as measured at this size.

    Parameters
    ----------
    table, figure : str
        What the thesis calls it.
    scene : MitsubaScene
    result : AcquisitionResult
    images : (ndarray, ndarray)
        A picture relit, and its truth.
    **more
        Further values of the row.
    """
    return {
        "table": table,
        "figure": figure,
        "world": scene.world.name,
        "camera_shape": list(scene.camera_shape),
        "projector_shape": list(scene.projector_shape),
        "camera_rays": int(np.prod(scene.camera_shape)),
        "rays": int(np.prod(scene.projector_shape)),
        "patterns": result.patterns,
        "megabytes": result.transport.nbytes / 1e6,
        "processing_s": result.processing_seconds,
        "error": relative_rms(*images),
        "noise": scene.recording.noise["half_lit"]["whole"],
        **more,
    }
