"""The cameras of the bench in software besides pylon's: drivers on their virtual devices."""

from __future__ import annotations

import ctypes
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry.camera import CameraModel
from rfpipe.pictures.dng import dng_bytes
from rfpipe.rigs.bench import Scenery, View
from rfpipe.rigs.cameras.aravis import AravisCamera
from rfpipe.rigs.cameras.aravis_library import call
from rfpipe.rigs.cameras.gphoto import PhotoCamera
from rfpipe.rigs.cameras.webcam import V4L2_TICKS, Webcam, load_opencv

__all__ = [
    "AravisBenchCamera",
    "PhotoBenchCamera",
    "PreparedCamera",
    "VirtualUvc",
    "WebcamBenchCamera",
]

FAKE_SERIAL = "1"
"""Of Aravis' fake camera."""

PICTURES_A_SESSION = 20
"""libgphoto2's virtual camera is full after 26, and only a new session empties it."""

FAKE_HERTZ = 1000.0
"""How often it looks for a trigger."""

_FILL = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


class PreparedCamera(AravisCamera):
    """Aravis' fake camera, which takes what lies before it.

    Parameters
    ----------
    sensor : CameraModel
    settings
        As `AravisCamera` has them.

    Attributes
    ----------
    frame : bytes
        The next frame, as the pixel format has it.
    """

    frame: bytes = b""

    def __init__(self, sensor: CameraModel, **settings: Any) -> None:
        self._fill = _FILL(self._copy)  # kept, as the library calls it
        super().__init__(sensor, **{**settings, "serial": FAKE_SERIAL, "fake": True})

    def put(self, counts: NDArray[np.uint16], bits: int) -> None:
        """Lay counts (H, W) before the camera."""
        self.frame = counts.astype(np.uint8 if bits == 8 else "<u2").tobytes()

    def _start(self) -> None:
        fake = call("arv_fake_device_get_fake_camera", self._device)
        call("arv_fake_camera_set_fill_pattern", fake, self._fill, None, None)
        call("arv_fake_camera_set_trigger_frequency", fake, FAKE_HERTZ)
        super()._start()

    def _copy(self, buffer: int, *_: Any) -> None:
        """Fill the library's buffer with the picture; is called by a thread of its own."""
        ctypes.memmove(call("arv_buffer_get_data", buffer, None), self.frame, len(self.frame))


class AravisBenchCamera(PreparedCamera):
    """Aravis' fake camera, each of its pictures made when it is triggered.

    Parameters
    ----------
    scenery : Scenery
    sensor : CameraModel
        What the rig believes of the camera; its exposures are set, its noise is not used.
    settings
        As `AravisCamera` has them; serial and shape are the bench's.

    Raises
    ------
    CaptureError
        When Aravis is missing.
    InputError
        When its fake camera has no such pixel format.
    """

    def __init__(self, scenery: Scenery, sensor: CameraModel, **settings: Any) -> None:
        if scenery.camera.bits != (16 if sensor.bayer is None else 8):
            raise InputError(
                f"sensor.bits is {scenery.camera.bits}; the bench with camera.driver aravis, which "
                "is Aravis' fake camera, has Mono16, or a colour mosaic of 8 bits"
            )
        self._view = View(scenery)
        self._armed_for: float | None = None
        self._filled = threading.Event()
        super().__init__(sensor, **{**settings, "shape": scenery.path.camera_shape})

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"kind": "bench of aravis"} | self._view.scenery.describe()

    def arm(self, exposure: float, count: int) -> None:
        """Wait for triggers by the bench's projector; see `SequenceCamera`."""
        self._armed_for = exposure
        super().arm(exposure, count)

    def collect(self) -> NDArray[np.uint16]:
        """Return the frames since `arm`; see `SequenceCamera`."""
        frames = super().collect()
        self._armed_for = None
        return frames

    def trigger(self) -> None:
        """Take a frame while armed, as the projector's signal would have it."""
        if self._armed_for is None:
            return
        self._before_trigger(self._armed_for)
        self._filled.clear()
        super()._expect()
        self._filled.wait(self._options.timeout_seconds)

    def _frame(self, exposure: float) -> tuple[NDArray[np.uint16] | None, str]:
        self._armed_for = None  # also after an `arm` that failed
        return super()._frame(exposure)

    def _expect(self) -> None:
        if self._armed_for is None:  # the fake camera fills whatever it has, triggered or not
            super()._expect()

    def _copy(self, buffer: int, *_: Any) -> None:
        super()._copy(buffer)
        self._filled.set()

    def _before_trigger(self, exposure: float) -> None:
        self.put(self._view.frame(exposure), self._view.scenery.camera.bits)


class PhotoBenchCamera(PhotoCamera):
    """libgphoto2's virtual camera, each of its raw files made when it is released.

    Parameters
    ----------
    scenery : Scenery
    sensor : CameraModel
        What the rig believes of the camera; its exposures are set, its noise is not used.
    settings
        As `PhotoCamera` has them; the folder is the bench's.

    Raises
    ------
    CaptureError
        When gphoto2 or rawpy is missing.
    InputError
        When the bench's camera has no colour mosaic.
    """

    def __init__(self, scenery: Scenery, sensor: CameraModel, **settings: Any) -> None:
        if scenery.camera.bayer is None:
            raise InputError(
                "sensor.bayer is null; the bench with camera.driver gphoto2 makes raw files of a "
                "colour mosaic: set it to RGGB, and bench.scene.channels to 3"
            )
        self._view = View(scenery)
        self._folder = Path(tempfile.mkdtemp(prefix="rfpipe-bench-"))
        self._put(np.zeros(scenery.path.camera_shape, np.uint16), 1.0)
        self._released = 0
        # to delete a picture takes the virtual camera a quarter of a second
        own = {"virtual": str(self._folder), "keep_pictures": True}
        try:
            super().__init__(sensor, **{**settings, **own})
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"kind": "bench of gphoto2"} | self._view.scenery.describe()

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        super().close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _before_trigger(self, exposure: float) -> None:
        if self._released == PICTURES_A_SESSION:
            self._restart()
        self._put(self._view.frame(exposure), exposure)
        self._released += 1

    def _connect(self) -> None:
        super()._connect()
        self._released = 0

    def _put(self, counts: NDArray[np.uint16], seconds: float) -> None:
        """Lay a raw file before the virtual camera, which knows only the length that it had."""
        true = self._view.scenery.camera
        assert true.bayer is not None
        made = self._folder / "next"
        made.write_bytes(
            dng_bytes(counts, seconds, true.bayer, true.black_level_counts, true.white_level)
        )
        made.replace(self._folder / "raw.jpg")


class VirtualUvc:
    """A V4L2 camera in software: controls that hold what they are told, frames from files.

    OpenCV opens the files, one after the other, as an image sequence. Frames that are on their way
    when the picture changes still show the old one, as a driver's buffers do.

    Parameters
    ----------
    folder : Path
        Where the frames lie.
    late : int
        Frames that are on their way.
    """

    def __init__(self, folder: Path, late: int) -> None:
        self._cv2 = load_opencv()
        self._folder, self._late = folder, late
        self._controls: dict[int, float] = {}
        self._last: NDArray[np.uint8] | None = None
        self._capture: Any = None
        self._number = 0

    def put(self, frame: NDArray[np.uint8]) -> None:
        """Lay the next frame, (H, W) or (H, W, 3), before the camera."""
        old = frame if self._last is None else self._last
        for shown in (*(old,) * self._late, frame):
            path = self._folder / f"{self._number:08d}.png"
            self._number += 1
            if not self._cv2.imwrite(str(path), shown, [self._cv2.IMWRITE_PNG_COMPRESSION, 0]):
                raise CaptureError(f"{path}: can't be written; is the disk full?")
        self._last = frame
        if self._capture is None:
            pattern = str(self._folder / "%08d.png")
            self._capture = self._cv2.VideoCapture(pattern, self._cv2.CAP_IMAGES)
        # those read are not needed any more, but for the first, by which OpenCV finds the series
        for number in range(max(1, self._number - 20), self._number - 10):
            (self._folder / f"{number:08d}.png").unlink(missing_ok=True)

    def isOpened(self) -> bool:  # noqa: N802
        """Tell whether there are frames."""
        return bool(self._capture.isOpened())

    def grab(self) -> bool:
        """Take a frame, and leave it."""
        return bool(self._capture.grab())

    def read(self) -> tuple[bool, NDArray[np.uint8] | None]:
        """Take a frame."""
        arrived, frame = self._capture.read()
        return arrived, frame

    def set(self, prop: int, value: float) -> bool:
        """Make a setting."""
        self._controls[prop] = float(value)
        return True

    def get(self, prop: int) -> float:
        """Return a setting."""
        return self._controls.get(prop, 0.0)

    def getBackendName(self) -> str:  # noqa: N802
        """Name the backend whose controls these are."""
        return "V4L2"

    def release(self) -> None:
        """Let go."""
        self._capture.release()


class WebcamBenchCamera(Webcam):
    """A virtual webcam, each of its frames made when it is asked for.

    Parameters
    ----------
    scenery : Scenery
    sensor : CameraModel
        What the rig believes of the camera; its exposures are set, its noise is not used.
    settings
        As `Webcam` has them; device and shape are the bench's.

    Raises
    ------
    CaptureError
        When OpenCV is missing.
    """

    def __init__(self, scenery: Scenery, sensor: CameraModel, **settings: Any) -> None:
        self._view = View(scenery)
        self._folder = Path(tempfile.mkdtemp(prefix="rfpipe-bench-"))
        own = {"device": "of the bench", "shape": scenery.path.camera_shape}
        try:
            super().__init__(sensor, **{**settings, **own})
        except BaseException:
            shutil.rmtree(self._folder, ignore_errors=True)
            raise

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"kind": "bench of webcam"} | self._view.scenery.describe()

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        super().close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _opened(self) -> VirtualUvc:
        folder = Path(tempfile.mkdtemp(dir=self._folder))
        device = VirtualUvc(folder, self._options.skip_frames)
        dark = np.zeros((*self._view.scenery.path.camera_shape, 3), np.uint8)
        device.put(dark)
        for _ in range(self._options.skip_frames):
            device.grab()
        return device

    def _before_trigger(self, exposure: float) -> None:  # noqa: ARG002
        # as long as the camera was told, whatever the driver believes
        ticks = self._capture.get(load_opencv().CAP_PROP_EXPOSURE)
        counts = self._view.frame(ticks / V4L2_TICKS).astype(np.uint8)
        self._capture.put(counts if counts.ndim == 2 else counts[..., ::-1])
