"""Stage: the capture of a level by a rig behind an acquisition server."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError, StoreError
from rfpipe.photometry import Sensor, sensor_from_description
from rfpipe.rigs import RemoteRig, Rig
from rfpipe.rigs.calibrated import warn_of
from rfpipe.rigs.protocol import read_token
from rfpipe.stages import capture
from rfpipe.stages.aside import differing
from rfpipe.stages.capture import frame_settings
from rfpipe.stages.capturing.placing import Placing
from rfpipe.stages.capturing.sensors import SENSOR
from rfpipe.stages.folder import REFERENCE, AcquisitionFolder
from rfpipe.store import FrameStore, open_arrays

__all__ = ["BegunRig", "Rays", "begun_rig", "check_rig", "run"]


@dataclass(frozen=True)
class Rays:
    """The rays that the settings of a scene say a rig to have.

    Parameters
    ----------
    camera_shape, projector_shape : sequence of int
        See `rfpipe.blocks.RayDomain`.
    channels : int
        Colour channels, 1 or 3.
    """

    camera_shape: Sequence[int]
    projector_shape: Sequence[int]
    channels: int


def run(
    rays: Rays,
    folder: AcquisitionFolder,
    level: int,
    *,
    url: str,
    token_file: str | None,
    patience_seconds: float,
    placing: Placing | None = None,
    **options: Any,
) -> None:
    """Capture what isn't captured yet of a level; see `rfpipe.stages.capture.run`.

    The server is asked for patterns only where some are missing, so that what was captured can be
    processed anew without it.

    Parameters
    ----------
    rays : Rays
        They must be the rig's.
    folder : AcquisitionFolder
    level : int
    url : str
    token_file : str or None
        None takes the token from the environment.
    patience_seconds : float
    placing : Placing, optional
        Puts the scene before the rig, when patterns are to be shown.
    **options
        Of `rfpipe.stages.capture.run`.

    Raises
    ------
    ConfigError
        When there is no token.
    CaptureError
        When the rig isn't there, has other rays, or is another than that of what was captured
        before.
    """

    def connected() -> RemoteRig:
        if placing is not None:
            placing.place(folder.path.parent.name)
        file = None if token_file is None else Path(token_file)
        rig = RemoteRig(url, read_token(file), patience_seconds)
        try:
            check_rig(rig, rays, url)
            if level == 0:
                warn_of(rig.describe(), url)
        except BaseException:
            rig.close()
            raise
        return rig

    rig = begun_rig(rays, folder, connected) or connected()
    try:
        capture.run(rig, folder, level, **options)
    finally:
        rig.close()


def check_rig(rig: Rig, rays: Rays, name: str) -> None:
    """Raise CaptureError where a rig has other rays or channels."""
    camera = "camera rays (camera_shape; null for a coaxial rig)"
    for what, found, expected in (
        ("projector rays (shape, views)", tuple(rig.projector_shape), tuple(rays.projector_shape)),
        (camera, tuple(rig.camera_shape), tuple(rays.camera_shape)),
        ("channels", rig.channels, rays.channels),
    ):
        if found != expected:
            raise CaptureError(
                f"{name}: the rig has {found} {what}; the settings of the scene say {expected}. "
                "Set them to the rig's"
            )


def begun_rig(
    rays: Rays, folder: AcquisitionFolder, connect: Callable[[], RemoteRig]
) -> BegunRig | None:
    """Return the rig that an acquisition was begun with, None where nothing is captured yet."""
    try:
        with FrameStore.open(folder.store(0, REFERENCE)) as frames:
            if not frames.done.any():
                return None
            described = frames.attributes["rig"]
        store = folder.store(0, SENSOR)
        arrays = open_arrays(store).read_all() if store.exists() else None
        sensor = sensor_from_description(described["sensor"], arrays)
    except (StoreError, InputError, KeyError):
        return None  # the rig itself will say, and whoever reads the frames
    return BegunRig(rays, described, sensor, connect)


@dataclass
class BegunRig:
    """The rig of frames that are on disk, which is connected to only for more of them.

    Parameters
    ----------
    rays : Rays
    described : dict
        Its description when the first frames were captured.
    sensor : Sensor
    connect : callable
        Returns the rig.
    """

    rays: InitVar[Rays]
    described: dict[str, Any]
    sensor: Sensor
    connect: Callable[[], RemoteRig]
    seconds_per_pattern: float = field(default=0.0, init=False)

    def __post_init__(self, rays: Rays) -> None:
        self.camera_shape = tuple(rays.camera_shape)
        self.projector_shape = tuple(rays.projector_shape)
        self.channels = rays.channels
        self._rig: RemoteRig | None = None
        self._before: dict[str, dict[str, int]] = {}

    def capture(
        self, patterns: NDArray[np.float32], keys: Sequence[tuple[int, ...]]
    ) -> NDArray[Any]:
        """Show patterns and return their brackets; see `rfpipe.rigs.Rig.capture`.

        Raises
        ------
        CaptureError
            Also when the rig is another than at the beginning.
        """
        if self._rig is None:
            self._rig = self.connect()
            self._before = self._rig.statistics
            described = frame_settings(self._rig)
            if described != self.described:
                raise CaptureError(
                    f"{self._rig.url}: the rig is not that of the patterns captured before ("
                    f"{differing(self.described, described)}). Serve it with those settings, or "
                    "remove the acquisition's folder to begin anew"
                )
        return self._rig.capture(patterns, keys)

    @property
    def statistics(self) -> dict[str, dict[str, int]]:
        """What the rig's devices counted since it was connected to."""
        if self._rig is None:
            return {}
        return {
            device: {what: count - self._before.get(device, {}).get(what, 0) for what, count in of}
            for device, of in ((name, of.items()) for name, of in self._rig.statistics.items())
        }

    def describe(self) -> dict[str, Any]:
        """Return the description at the beginning."""
        return self.described

    def close(self) -> None:
        """Give the rig back, if it was needed."""
        if self._rig is not None:
            self._rig.close()
