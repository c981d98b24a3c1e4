"""What bad input and stopped runs lead to, beside the numerically hard scenes of `stability`."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import RfpipeError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes.hard import hard_cases
from rfpipe.scenes.reference import reference_scene
from rfpipe.scenes.relighting import relighting_patterns
from rfpipe.stages.evaluating.metrics import relative_rms
from rfpipe.stages.evaluating.studies import stopping
from rfpipe.stages.evaluating.studies.physical import Arrays, Rows

if TYPE_CHECKING:
    from rfpipe.config import Config
    from rfpipe.scenes.base import Scene
    from rfpipe.stages.acquire import AcquisitionResult

__all__ = ["faults_study"]

Float = NDArray[np.float32]
Frames = NDArray[Any]

_SCENE = "scene IV"
_SHAPE = (16, 16)
_BAD_KEY = (1, 1)  # the pattern that something happens to, of the first level below the root
_HANDS_OVER = "near_far"
_HOT, _DEAD = (3, 4), (9, 5)
_BRIGHT = 1e4  # times the light that the camera is set for
_CLOSED = "http://127.0.0.1:9"  # the port of the discard service, where nobody listens
_PATIENCE = 0.3  # seconds


def faults_study(config: Config) -> tuple[Rows, Arrays]:
    """Acquire scene IV while something goes wrong, and the hard scenes by a third method.

    Returns
    -------
    rows : list of dict
        ``case``, ``scene``, ``method``, ``camera``; ``rays``, ``patterns`` and ``relight_error``
        where something was acquired, else None: the largest relative RMS error of a reference
        pattern's picture; and ``happened``, in words.
    arrays : dict
        Empty.
    """
    rows = [*_settings(), *_frames(config), *_rigs(), *_handed_over(config)]
    with tempfile.TemporaryDirectory() as folder:
        rows += [_row(case, happened=told) for case, told in stopping.cases(Path(folder))]
    return rows, {}


def _row(case: str, scene: str = _SCENE, method: str = "symmetric", **more: Any) -> Any:
    unknown = dict.fromkeys(("rays", "patterns", "relight_error"))
    return {"case": case, "scene": scene, "method": method, "camera": "", **unknown, **more}


def _settings() -> Iterator[dict[str, Any]]:
    """Settings that can't be meant."""
    from rfpipe.config import parse_config

    plane = {"flat": {"kind": "plane", "surfaces": ["texture"]}}
    for case, settings in (
        ("unknown key", {"scenes": plane, "exposure": 1}),
        ("wrong unit", {"scenes": plane, "camera": {"exposures": ["16 ms"]}}),
    ):
        told = _refusal(partial(parse_config, settings, "config.yaml"))
        yield _row(case, scene="", method="", happened=told)


def _refusal(try_it: Callable[[], Any]) -> str:
    """Return what is said of bad input; that nothing is, where it is taken."""
    try:
        try_it()
    except RfpipeError as error:
        return f"refused: {_first_line(error)}"
    return "taken without a word"


def _first_line(error: Exception) -> str:
    """Return what an error says first, on one line."""
    return " ".join(str(error).split("\n\n")[0].split())


class _FaultyRig(SimulatedRig):
    """A simulated rig whose frames something happens to."""

    def __init__(self, spoil: Callable[[Frames, tuple[int, ...]], Frames], *arguments: Any) -> None:
        super().__init__(*arguments)
        self._spoil = spoil

    def capture(self, patterns: Float, keys: Sequence[tuple[int, ...]]) -> Frames:
        """Show patterns, as `SimulatedRig` does, and spoil their brackets."""
        frames = super().capture(patterns, keys)
        return np.stack([self._spoil(*each) for each in zip(frames, keys, strict=True)])


def _frames(config: Config) -> Iterator[dict[str, Any]]:
    """Frames that can't be pictures, or not everywhere."""
    from rfpipe.config import CameraConfig
    from rfpipe.photometry import sensor_from_config

    camera = (config.camera or CameraConfig()).model_copy(update={"bayer": None})
    bright = camera.model_copy(
        update={"electrons_per_radiance": _BRIGHT * camera.electrons_per_radiance}
    )
    sensor, saturating = sensor_from_config(camera), sensor_from_config(bright)
    full = 2**camera.bits - 1
    scene = reference_scene("IV", _SHAPE, channels=1)
    dark = hard_cases()["zero_transport"]()
    off = camera.black_level_counts

    def at_one_pattern(value: float) -> Callable[[Frames, tuple[int, ...]], Frames]:
        return lambda frame, key: np.full_like(frame, value) if key == _BAD_KEY else frame

    def defective(frame: Frames, _key: tuple[int, ...]) -> Frames:
        spoilt = frame.copy()
        spoilt[:, *_HOT], spoilt[:, *_DEAD] = full, 0
        return spoilt

    def swapped(frame: Frames, _key: tuple[int, ...]) -> Frames:
        below = np.maximum(2 * off - frame.astype(int), 0)
        return np.asarray(below, frame.dtype)

    def late(frame: Frames, key: tuple[int, ...]) -> Frames:
        if key == _BAD_KEY:
            time.sleep(_PATIENCE)
        return frame

    def as_it_is(frame: Frames, _key: tuple[int, ...]) -> Frames:
        return frame

    for case, spoil, before, how in (
        ("NaN in a frame", at_one_pattern(np.nan), scene, None),
        ("infinite frame", at_one_pattern(np.inf), scene, None),
        ("negative frame", at_one_pattern(-1.0), scene, None),
        ("frame of another size", lambda frame, _: frame[:, 1:], scene, sensor),
        ("rig answers late", late, scene, sensor),
        ("a dead and a hot pixel", defective, scene, sensor),
        ("saturated at every exposure", as_it_is, scene, saturating),
        ("floodlit image all black", as_it_is, dark, sensor),
        ("black level above the signal", swapped, scene, sensor),
    ):
        rig = _FaultyRig(spoil, before, how, config.seed)
        camera_is = "exact" if how is None else f"{camera.bits} bits"
        yield _acquired(case, before, "symmetric", rig, camera_is)


def _acquired(
    case: str, scene: Scene, method: str, rig: SimulatedRig, camera: str
) -> dict[str, Any]:
    """Acquire a scene, and say what happened."""
    from rfpipe.stages.acquire import acquire

    row: dict[str, Any] = _row(case, scene.describe()["scene"], method, camera=camera)
    try:
        result = acquire(rig, method, progress=False)
    except RfpipeError as error:
        return {**row, "happened": f"refused: {_first_line(error)}"}
    patterns = np.stack(list(relighting_patterns(rig.projector_shape).values()))
    relit = result.transport.relight_batch(patterns)
    truth = scene.apply(patterns.reshape(len(patterns), -1)).reshape(relit.shape)
    errors = [relative_rms(*pictures) for pictures in zip(relit, truth, strict=True)]
    rays = int(np.prod(rig.projector_shape))
    return {
        **row,
        "rays": rays,
        "patterns": result.patterns,
        "relight_error": max((e for e in errors if not np.isnan(e)), default=float("nan")),
        "happened": _told(result, method, rays),
    }


def _told(result: AcquisitionResult, method: str, rays: int) -> str:
    """Say what an acquisition did beside the usual."""
    told = []
    if result.masked.any():
        count = int(result.masked.sum())
        told.append(f"{count} camera pixels left out, and filled from what others see of them")
    if result.saturated:
        told.append(f"{result.saturated:,} samples clipped")
    if result.patterns > rays:
        told.append("as many patterns as brute force, or more")
    # its own levels subdivide nothing, those of symmetric photography that follow them do
    if method == _HANDS_OVER and result.levels["subdivided"].any():
        told.append("handed over to symmetric photography")
    return "; ".join(told) or "acquired"


def _rigs() -> Iterator[dict[str, Any]]:
    """A rig that doesn't answer."""
    from rfpipe.rigs import RemoteRig

    told = _refusal(lambda: RemoteRig(_CLOSED, "no token", _PATIENCE))
    yield _row("rig stops answering", method="", happened=told)


def _handed_over(config: Config) -> Iterator[dict[str, Any]]:
    """The hard scenes by the method that hands over where light isn't smooth."""
    for case, make in hard_cases().items():
        scene = make()
        rig = SimulatedRig(scene, None, config.seed)
        yield _acquired(case, scene, _HANDS_OVER, rig, "exact")
