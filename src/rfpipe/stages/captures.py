"""The stage that captures, with its rig: simulated, behind a server, or taken elsewhere."""

from __future__ import annotations

import logging
import os
import shlex
import subprocess
from collections.abc import Callable, Collection, Mapping
from contextlib import closing
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.errors import CaptureError, PicturesNeeded, StoreError
from rfpipe.rigs import RemoteRig
from rfpipe.rigs.calibrated import warn_of
from rfpipe.rigs.messages import read_token
from rfpipe.stages import capture
from rfpipe.stages.brackets import differing
from rfpipe.stages.plan import rig_of
from rfpipe.storage.files import REFERENCE_BRACKETS, AcquisitionFolder, name_of
from rfpipe.storage.retake import Retake, is_whole
from rfpipe.store import FrameStore

if TYPE_CHECKING:
    from rfpipe.config import Config

Capture = Callable[..., None]
"""``capture(folder, level, **options)``: `rfpipe.stages.capture.run` with its rig."""

_PATIENCE_BEFORE_RETAKE = 5.0  # seconds; somebody waits for the answer

_log = logging.getLogger(__name__)


def of_job(job: Any) -> Capture:
    """Return the capture stage of a job of any kind, by its parameter ``by``."""
    rig, asked = job.params.rig, job.asked
    if job.params.by == "simulation":
        return by_simulation(**rig, threads=job.resources.threads)
    if job.params.by == "pictures":
        return by_pictures(**rig)
    return partial(
        by_server,
        rig,
        url=asked.rig_url,
        token_file=asked.rig_token_file or None,
        patience_seconds=float(asked.rig_patience_seconds or 0),
        placing=asked.rig_placing,
    )


def by_simulation(
    scene: Mapping[str, Any], camera: Mapping[str, Any] | None, threads: int, **rig: Any
) -> Capture:
    """Return the capture stage of a `SimulatedRig`, of settings of a scene and of a camera."""
    from rfpipe.config import CameraConfig, SceneSettings
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config

    before = scene_from_config(SceneSettings.model_validate(scene))
    sensor = sensor_from_config(CameraConfig(**camera) if camera else None)
    return partial(capture.run, SimulatedRig(before, sensor, **rig, threads=threads))


def by_pictures(
    offline: Mapping[str, Any], camera: Mapping[str, Any] | None, **rays: Any
) -> Capture:
    """Return the capture stage of an offline rig, which says which pictures are missing."""
    from rfpipe.config import CameraConfig, OfflineConfig
    from rfpipe.rigs.offline import offline_rig

    shapes = tuple(rays["camera_shape"]), tuple(rays["projector_shape"])
    of_camera = CameraConfig(**camera) if camera else None
    rig = offline_rig(OfflineConfig(**offline), of_camera, *shapes, rays["channels"])

    def run(folder: AcquisitionFolder, level: int, **options: Any) -> None:
        try:
            capture.run(rig, folder, level, **options)
        except PicturesNeeded as needed:
            raise PicturesNeeded(
                f"{Path(*folder.path.parts[-2:])}: {name_of(level)} waits for pictures. Write its "
                "patterns with 'rfpipe patterns CONFIG', take them, and read the pictures with "
                "'rfpipe import FOLDER'"
            ) from needed

    return run


def by_server(
    rays: Mapping[str, Any],
    folder: AcquisitionFolder,
    level: int,
    *,
    url: str,
    token_file: str | None,
    patience_seconds: float,
    placing: str = "",
    **options: Any,
) -> None:
    """Capture what isn't captured yet of a level, by a rig behind an acquisition server.

    The server isn't asked where nothing is missing. `rays` are the rig's shapes and channels;
    `options` those of `rfpipe.stages.capture.run`. Without `token_file` the token is the
    environment's.

    Raises
    ------
    ConfigError
        When there is no token.
    CaptureError
        When the rig isn't there, has other rays, or isn't that of what was captured before.
    """
    if capture.stands_already(folder, level, options):
        return
    if placing:
        place(placing, folder.path.parent.name)
    rig = RemoteRig(url, read_token(Path(token_file) if token_file else None), patience_seconds)
    with closing(rig):
        _check_rays(rig, rays, url)
        if level == 0:
            warn_of(rig.describe(), url)
        _check_begun(rig, folder)
        capture.run(rig, folder, level, **options)


def check_retakes(config: Config, retakes: Collection[Retake]) -> None:
    """Check, before pictures are set aside, that the rig can take them again.

    A simulated rig always can. One behind a server has to answer within a few seconds, and has to
    be that of the pictures which stay; where all of an acquisition are taken again, it may be
    another one.

    Raises
    ------
    ConfigError
        When there is no token.
    CaptureError
        When the rig doesn't answer, has other rays, or isn't that of the pictures which stay.
    """
    if config.capture.rig != "remote":
        return
    for path in dict.fromkeys(retake.folder.path for retake in retakes):
        folder = AcquisitionFolder(path)
        scene = path.parent.name
        asked = config.of_scene(scene).capture
        token = read_token(Path(asked.token_file) if asked.token_file else None)
        patience = min(asked.patience_seconds, _PATIENCE_BEFORE_RETAKE)
        try:
            with closing(RemoteRig(str(asked.url), token, patience)) as rig:
                _check_rays(rig, rig_of(config, scene)["rig"], str(asked.url))
                if not is_whole(retakes, folder):
                    _check_begun(rig, folder)
        except CaptureError as error:
            raise CaptureError(f"{error}. --retake has set nothing aside") from error


@cache
def place(command: str, scene: str) -> None:
    """Have the user's command put a scene before the rig, once in a process.

    The command is quoted as for a shell, which isn't used; it finds ``RFPIPE_SCENE`` in its
    environment. Raises CaptureError where it fails: nothing is captured then.
    """
    _log.info("placing %s: %s", scene, command)
    try:
        environment = {**os.environ, "RFPIPE_SCENE": scene}
        subprocess.run(shlex.split(command), env=environment, check=True)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise CaptureError(
            f"{scene} was not put before the rig: capture.placing {command!r} failed ({error}). "
            "Nothing was captured; mend that and run again"
        ) from error


def _check_rays(rig: RemoteRig, rays: Mapping[str, Any], name: str) -> None:
    expected = {key: tuple(it) if isinstance(it, list) else it for key, it in rays.items()}
    held = {key: getattr(rig, key) for key in expected}
    if held != expected:
        raise CaptureError(
            f"{name}: the rig has {held}; the settings of the scene say {expected} (camera_shape: "
            "null for a coaxial rig). Set them to the rig's"
        )


def _check_begun(rig: RemoteRig, folder: AcquisitionFolder) -> None:
    """Refuse to go on with another rig than that of the frames that are on disk."""
    begun_with = _begun_with(folder)
    described = capture.frame_settings(rig)
    if begun_with not in (None, described):
        raise CaptureError(
            f"{rig.url}: the rig is not that of the patterns captured before ("
            f"{differing(begun_with, described)}). Serve it with those settings, or "
            f"begin anew with this rig: '{folder.retaking()}', with the run's other options"
        )


def _begun_with(folder: AcquisitionFolder) -> dict[str, Any] | None:
    """Description of the rig that took the first frames, None where none are captured.

    Also None where they can't be read: their own stage reports the damage.
    """
    try:
        with FrameStore.open(folder.store(0, REFERENCE_BRACKETS)) as frames:
            return dict(frames.attributes["rig"]) if frames.done.any() else None
    except (StoreError, KeyError):
        return None
