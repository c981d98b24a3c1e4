"""Sources of the rig of a capture: a given rig, a simulation, a server, or a folder of pictures."""

from __future__ import annotations

import logging
import os
import shlex
import subprocess
from collections.abc import Collection, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rfpipe.errors import CaptureError, PicturesNeeded, StoreError
from rfpipe.rigs import RemoteRig, Rig
from rfpipe.rigs.calibrated import warn_of
from rfpipe.rigs.messages import read_token
from rfpipe.stages.settings import rig_source_settings
from rfpipe.storage.base import REFERENCE_BRACKETS, Storage, level_name, rig_settings
from rfpipe.storage.differences import differing
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.retake import Retake, is_complete

if TYPE_CHECKING:
    from rfpipe.config import Config

_PATIENCE_BEFORE_RETAKE = 5.0  # seconds; somebody waits for the answer

_log = logging.getLogger(__name__)


class RigSource(Protocol):
    """Provides the rig that captures a level."""

    @property
    def recorded_rig_suffices(self) -> bool:
        """True if a level that the rig of its manifest captured counts as captured.

        Otherwise that rig is compared with the current one.
        """

    def rig(self, storage: Storage, level: int) -> AbstractContextManager[Rig]:
        """Provide the rig; errors as `rfpipe.stages.capture.run`."""


@dataclass(frozen=True)
class GivenRig:
    """A rig that exists."""

    given: Rig
    recorded_rig_suffices: bool = False

    def rig(self, storage: Storage, level: int) -> AbstractContextManager[Rig]:  # noqa: ARG002
        """Provide the rig."""
        return nullcontext(self.given)


@dataclass(frozen=True)
class OfflineSource:
    """An offline rig, which reports the pictures that are missing."""

    given: Rig
    recorded_rig_suffices: bool = False

    @contextmanager
    def rig(self, storage: Storage, level: int) -> Iterator[Rig]:
        """Provide the rig; PicturesNeeded names the acquisition and the level."""
        try:
            yield self.given
        except PicturesNeeded as needed:
            assert isinstance(storage, FolderStorage)
            raise PicturesNeeded(
                f"{Path(*storage.path.parts[-2:])}: {level_name(level)} waits for pictures",
                remedy="Write its patterns with 'rfpipe patterns CONFIG', take them, and read "
                "the pictures with 'rfpipe import FOLDER'",
            ) from needed


@dataclass(frozen=True)
class RemoteSource:
    """A rig behind an acquisition server; it is connected only if brackets are missing.

    Attributes
    ----------
    rays : mapping
        The expected ``camera_shape``, ``projector_shape`` and ``channels``.
    url : str
        Address of the server.
    token_file : str, optional
        File of the server's token; by default the token is the environment's.
    patience_seconds : float
        Time to wait for a server or rig that fails.
    placing : str
        Command that puts the scene before the rig, "" for none.
    """

    rays: Mapping[str, Any]
    url: str
    token_file: str | None
    patience_seconds: float
    placing: str = ""
    recorded_rig_suffices: bool = True

    @contextmanager
    def rig(self, storage: Storage, level: int) -> Iterator[Rig]:
        """Connect to the rig.

        Raises
        ------
        ConfigError
            When the token is missing.
        CaptureError
            When the rig doesn't answer, has other rays, or didn't take the brackets so far.
        """
        assert isinstance(storage, FolderStorage)
        if self.placing:
            place_scene(self.placing, storage.path.parent.name)
        token = read_token(Path(self.token_file) if self.token_file else None)
        with closing(RemoteRig(self.url, token, self.patience_seconds)) as rig:
            _check_rays(rig, self.rays, self.url)
            if level == 0:
                warn_of(rig.describe(), self.url)
            _check_same_rig(rig, storage)
            yield rig


def rig_source(
    kind: str, settings: Mapping[str, Any], threads: int = 1, **access: Any
) -> RigSource:
    """Return the source of the rig of a job.

    Parameters
    ----------
    kind : {"simulated", "remote", "offline"}
    settings : mapping
        See `rfpipe.stages.settings.rig_source_settings`.
    threads : int
        Threads of a simulated rig.
    **access
        Access to a remote rig, see `RemoteSource`.
    """
    if kind == "remote":
        return RemoteSource(settings, **access)
    if kind == "offline":
        return _offline_source(**settings)
    return _simulated_source(**settings, threads=threads)


def _simulated_source(
    scene: Mapping[str, Any], camera: Mapping[str, Any] | None, threads: int, **options: Any
) -> GivenRig:
    from rfpipe.config import CameraConfig, SceneSettings
    from rfpipe.photometry import sensor_from_config
    from rfpipe.rigs import SimulatedRig
    from rfpipe.scenes import scene_from_config

    simulated_scene = scene_from_config(SceneSettings.model_validate(scene))
    sensor = sensor_from_config(CameraConfig(**camera) if camera else None)
    return GivenRig(SimulatedRig(simulated_scene, sensor, **options, threads=threads))


def _offline_source(
    offline: Mapping[str, Any], camera: Mapping[str, Any] | None, **rays: Any
) -> OfflineSource:
    from rfpipe.config import CameraConfig, OfflineConfig
    from rfpipe.rigs.offline import offline_rig

    shapes = tuple(rays["camera_shape"]), tuple(rays["projector_shape"])
    camera_config = CameraConfig(**camera) if camera else None
    config = OfflineConfig(**offline)
    return OfflineSource(offline_rig(config, camera_config, *shapes, rays["channels"]))


def check_retakes(config: Config, retakes: Collection[Retake]) -> None:
    """Check, before pictures are set aside, that the rig can take them again.

    A simulated rig always can. A rig behind a server has to answer within a few seconds, and has
    to be the rig of the pictures that stay. If all pictures of an acquisition are taken again, it
    may be another rig.

    Raises
    ------
    ConfigError
        When the token is missing.
    CaptureError
        When the rig doesn't answer, has other rays, or didn't take the pictures that stay.
    """
    if config.capture.rig != "remote":
        return
    for path in dict.fromkeys(retake.folder.path for retake in retakes):
        folder = FolderStorage(path)
        try:
            _check_retake(config, folder, may_change_rig=is_complete(retakes, folder))
        except CaptureError as error:
            raise CaptureError(
                f"{error.problem}; --retake has set nothing aside", remedy=error.remedy
            ) from error


def _check_retake(config: Config, folder: FolderStorage, *, may_change_rig: bool) -> None:
    """Check that the remote rig can take the pictures of an acquisition again."""
    scene = folder.path.parent.name
    capture = config.of_scene(scene).capture
    token = read_token(Path(capture.token_file) if capture.token_file else None)
    patience = min(capture.patience_seconds, _PATIENCE_BEFORE_RETAKE)
    with closing(RemoteRig(str(capture.url), token, patience)) as rig:
        _check_rays(rig, rig_source_settings(config, scene)["settings"], str(capture.url))
        if not may_change_rig:
            _check_same_rig(rig, folder)


@cache
def place_scene(command: str, scene: str) -> None:
    """Run the user's command that puts a scene before the rig, once in a process.

    The command is quoted as for a shell, which isn't used; ``RFPIPE_SCENE`` in its environment is
    the scene. Raises CaptureError where it fails, before anything is captured.
    """
    _log.info("placing %s: %s", scene, command)
    try:
        environment = {**os.environ, "RFPIPE_SCENE": scene}
        subprocess.run(shlex.split(command), env=environment, check=True)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        raise CaptureError(
            f"{scene} was not put before the rig: capture.placing {command!r} failed ({error}). "
            "Nothing was captured",
            remedy="fix this and run again",
        ) from error


def _check_rays(rig: RemoteRig, rays: Mapping[str, Any], name: str) -> None:
    expected = {key: tuple(it) if isinstance(it, list) else it for key, it in rays.items()}
    actual = {key: getattr(rig, key) for key in expected}
    if actual != expected:
        raise CaptureError(
            f"{name}: the rig has {actual}; the settings of the scene say {expected} "
            "(camera_shape: null for a coaxial rig)",
            remedy="Set them to the rig's",
        )


def _check_same_rig(rig: RemoteRig, folder: FolderStorage) -> None:
    """Refuse another rig than the one that took the brackets on disk."""
    recorded, described = _recorded_rig(folder), rig_settings(rig)
    if recorded not in (None, described):
        raise CaptureError(
            f"{rig.url}: the rig is not that of the patterns captured before ("
            f"{differing(recorded, described)})",
            remedy="Serve it with those settings, or "
            f"begin anew with this rig: '{folder.retake_command()}', with the run's other options",
        )


def _recorded_rig(folder: FolderStorage) -> dict[str, Any] | None:
    """Description of the rig of the first brackets; None without any, or where they are damaged."""
    try:
        with folder.partial_brackets(0, REFERENCE_BRACKETS) as store:
            return dict(store.attributes["rig"]) if store.done.any() else None
    except (StoreError, KeyError):
        return None
