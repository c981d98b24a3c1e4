"""GenICam cameras of all makers (GigE Vision, USB3 Vision), through the library Aravis.

Tested on Aravis' fake camera, in the process and by GigE Vision over the loopback. Never tried on
a camera of metal: look at the first frames with care.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.cameras.aravis_library import (
    STATUSES,
    AravisError,
    AravisNodes,
    call,
    connected,
    counts_of,
    load_aravis,
    release,
    tried,
)
from rfpipe.rigs.cameras.bracket import chosen, options_of
from rfpipe.rigs.cameras.genicam import RefusedError
from rfpipe.rigs.cameras.genicam_camera import GenicamCamera
from rfpipe.rigs.cameras.options import GenicamOptions

__all__ = ["AravisCamera", "AravisOptions"]

Counts = NDArray[np.uint16]

_log = logging.getLogger(__name__)


class AravisOptions(GenicamOptions):
    """A GenICam camera, through Aravis."""

    fake: bool = Field(
        False,
        description="Whether to take Aravis' own fake camera, to rehearse without one: true or "
        "false.",
    )


class AravisCamera(GenicamCamera):
    """A GenICam camera that takes brackets by software trigger, and sequences by a projector's.

    All automatic functions are off and the gain is fixed. Failed frames and a lost camera are
    treated as every `BracketCamera` does. Never tried on a camera of metal.

    Parameters
    ----------
    sensor : CameraModel
        Exposures, bits and mosaic, which choose the pixel format, and what is known of the noise.
    options
        As `AravisOptions` has them, by name, the same where they aren't given; the pixel format is
        the sensor's.

    Raises
    ------
    CaptureError
        When Aravis is missing, no camera answers, or it refuses a setting: says which.
    """

    kind = "aravis"
    Options = AravisOptions
    bench = "rfpipe.rigs.bench_cameras:AravisBenchCamera"
    faults = AravisError, RefusedError

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        own = options_of(AravisOptions, options, "a GenICam camera")
        super().__init__(sensor, own)
        self._fake: bool = own.fake
        load_aravis()
        self._device: int | None = None
        self._stream: int | None = None
        self._payload = 0
        self.shape = self._open()

    @property
    def nodes(self) -> AravisNodes:
        """The open camera's settings."""
        assert self._device is not None
        return AravisNodes(self._device)

    def _is_lost(self) -> bool:
        return self._device is None

    def _frame(self, exposure: float) -> tuple[Counts | None, str]:
        """Take one frame; return it, or None and what is wrong."""
        self._setup.set_exposure(self.nodes, exposure)
        self._before_trigger(exposure)
        self._expect()  # one at a time: what comes without being asked for finds no buffer
        self.nodes.execute("TriggerSoftware")
        return self._awaited(exposure + self._options.timeout_seconds)

    def _expect(self) -> None:
        call("arv_stream_push_buffer", self._stream, call("arv_buffer_new_allocate", self._payload))

    def _next(self, seconds: float) -> tuple[Counts | None, str]:
        buffer = call("arv_stream_timeout_pop_buffer", self._stream, round(1e6 * seconds))
        if not buffer:
            return None, ""
        try:
            status = call("arv_buffer_get_status", buffer)
            if status != 0:
                return None, STATUSES.get(status, f"status {status}")
            return counts_of(buffer, self.sensor.bits, self._payload), ""
        finally:
            release(buffer)

    def _open(self) -> tuple[int, int]:
        """Find the camera, set it up and start it; return the frames' shape."""
        found = connected(fake=self._fake)
        camera = found[chosen((each.serial for each in found), self._serial)]
        self._serial, self._model = camera.serial, camera.model
        self._name = f"camera {self._serial}"
        try:
            self._device = tried("arv_open_device", camera.id)
            shape = self._setup.apply(self.nodes)
            bytes_a_pixel = 1 if self.sensor.bits == 8 else 2
            self._payload = shape[0] * shape[1] * bytes_a_pixel
            if self.nodes.has("PayloadSize"):  # what a camera adds to the picture has room, too
                self._payload = max(self._payload, self.nodes.integer("PayloadSize"))
            self._start()
        except AravisError as error:
            self._drop()
            raise CaptureError(
                f"camera {self._serial}: can't be opened: {error}. Close other programs that hold "
                "it, and check its power and cable"
            ) from error
        except CaptureError:
            self._drop()
            raise
        _log.info(
            "camera %s (%s): %s, %d x %d",
            self._serial, self._model, self._setup.pixel_format, *shape,
        )  # fmt: skip
        return shape

    def _start(self) -> None:
        self._stream = tried("arv_device_create_stream", self._device, None, None)
        self.nodes.execute("AcquisitionStart")

    def _stop(self) -> None:
        self.nodes.execute("AcquisitionStop")
        stream, self._stream = self._stream, None
        release(stream)

    def _drop(self) -> None:
        """Let go of the device, whatever state it is in."""
        device, self._device = self._device, None
        stream, self._stream = self._stream, None
        if device is not None:
            try:
                AravisNodes(device).execute("AcquisitionStop")
            except AravisError as error:
                _log.debug("camera %s: %s", self._serial, error)
        release(stream)
        release(device)
