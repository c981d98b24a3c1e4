"""GenICam cameras of all makers (GigE Vision, USB3 Vision), through the library Aravis.

Tested with Aravis' fake camera, in the process and by GigE Vision over the loopback interface, but
not with a physical camera: check the first frames carefully.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from rfpipe.array_types import Counts
from rfpipe.devices.aravis_library import (
    AravisError,
    AravisNodes,
    call,
    checked_call,
    counts_of,
    list_cameras,
    load_aravis,
    release,
)
from rfpipe.devices.genicam import GenicamCamera, RefusedError, select_camera
from rfpipe.photometry.camera import CameraModel


class AravisCamera(GenicamCamera):
    """A GenICam camera of any maker; not tested with a physical camera.

    `GenicamOptions` lists the options. CaptureError where Aravis is missing, no camera responds,
    or it refuses a setting, which the message names.
    """

    kind = "aravis"
    faults = AravisError, RefusedError

    def __init__(self, sensor: CameraModel, **options: Any) -> None:
        super().__init__(sensor, **options)
        load_aravis()
        self._stream: int | None = None
        self._payload = 0
        self.shape = self._open()

    @property
    def nodes(self) -> AravisNodes:
        """The open camera's settings."""
        assert self._handle is not None
        return AravisNodes(self._handle)

    def _trigger(self) -> None:
        self._add_buffer()  # one at a time: an unexpected frame finds no buffer
        self.nodes.execute("TriggerSoftware")

    def _add_buffer(self) -> None:
        """Add a buffer for one more frame; the library allocates none itself."""
        call("arv_stream_push_buffer", self._stream, call("arv_buffer_new_allocate", self._payload))

    def _next_frame(self, seconds: float) -> tuple[Counts | None, str]:
        buffer = call("arv_stream_timeout_pop_buffer", self._stream, round(1e6 * seconds))
        if not buffer:
            return None, ""
        try:
            status = call("arv_buffer_get_status", buffer)
            if status != 0:
                return None, f"the frame has ArvBufferStatus {status}"
            return counts_of(buffer, self.sensor.bits, self._payload), ""
        finally:
            release(buffer)

    def _connect(self) -> None:
        cameras = list_cameras()
        index = select_camera((serial for _, serial, _ in cameras), self._serial)
        identity, self._serial, self._model = cameras[index]
        self._handle = checked_call("arv_open_device", identity)

    def _set_up(self) -> tuple[int, int]:
        shape = super()._set_up()
        self._payload = shape[0] * shape[1] * (1 if self.sensor.bits == 8 else 2)
        # a camera may append metadata to the pixels
        self._payload = max(self._payload, int(self.nodes.number("PayloadSize") or 0))
        return shape

    def _start(self, room: int = 0) -> None:
        self._stream = checked_call("arv_device_create_stream", self._handle, None, None)
        for _ in range(room):
            self._add_buffer()
        self.nodes.execute("AcquisitionStart")

    def _stop(self) -> None:
        self.nodes.execute("AcquisitionStop")
        stream, self._stream = self._stream, None
        release(stream)

    def _release(self, handle: int) -> None:
        with suppress(AravisError):
            AravisNodes(handle).execute("AcquisitionStop")
        stream, self._stream = self._stream, None
        release(stream)
        release(handle)
