"""An optical bench in software: a simulated scene between a projector driver and a camera driver.

The projector draws into an array instead of a display. At each trigger of the camera, the light
transport of the scene gives the radiance at the camera's pixels, the camera model adds noise, and
the virtual camera of the driver's library delivers the counts as its next frame.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np

from rfpipe.array_types import Codes, Counts, Float
from rfpipe.devices.optical_path import OpticalPath, optical_path
from rfpipe.devices.pylon import PylonCamera
from rfpipe.devices.window import WindowProjector
from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel, sensor_from_config
from rfpipe.provenance import fingerprint
from rfpipe.rigs.calibrated import calibration_of, sensor_of
from rfpipe.rigs.devices import Camera, check_picture

if TYPE_CHECKING:
    from rfpipe.config import RigConfig


class BenchScene:
    """The display of a bench, the scene lit by it, and the true properties of the camera.

    As a display, it takes the place of the window of `rfpipe.devices.window.WindowProjector`.

    Parameters
    ----------
    light_of_code : ndarray of float32, shape (256,)
        The projector's true response.
    camera : CameraModel
        Noise, bits and mosaic; the driver sets the exposures.
    delay_seconds : float
        Time from drawing a picture until its light appears.
    knock : (int, int, int), optional
        Number of exposures before the projector is moved, and the shift of its picture from then
        on, in pixels down and to the right.

    Attributes
    ----------
    codes : ndarray of uint8, shape path.projector_shape
        The last drawn picture.
    """

    def __init__(
        self,
        path: OpticalPath,
        light_of_code: Float,
        camera: CameraModel,
        seed: int = 0,
        delay_seconds: float = 0.0,
        knock: tuple[int, int, int] | None = None,
    ) -> None:
        self.path, self.camera = path, camera
        self.shape = path.projector_shape
        self.codes: Codes = np.zeros(self.shape, np.uint8)
        self._light, self._seed = light_of_code, seed
        self._delay, self._knock = delay_seconds, knock
        self._drawn: deque[tuple[float, Codes]] = deque(maxlen=16)
        self._number = 0
        self._last_radiance: tuple[Codes, Float] | None = None

    def draw(self, codes: Codes) -> None:
        """Draw a picture; its light appears after the delay."""
        self.codes = codes
        self._drawn.append((time.monotonic(), codes))

    def is_undisturbed(self) -> bool:
        """Return True: no other program draws on this display."""
        return True

    def close(self) -> None:
        """Do nothing; the display needs no release."""

    def frame(self, exposure: float) -> Counts:
        """Expose the next frame: counts (Hc, Wc[, 3]) with independent noise."""
        self._number += 1
        codes = self._lit()
        if self._last_radiance is None or not np.array_equal(codes, self._last_radiance[0]):
            self._last_radiance = codes, self._radiance(codes)
        camera = replace(self.camera, exposures=(exposure,))
        counts: Counts = camera.expose(self._last_radiance[1], self._seed, (self._number,))[0]
        return counts[..., 0] if counts.shape[2:] == (1,) else counts

    def _radiance(self, codes: Codes) -> Float:
        """Compute the radiance at the camera under codes (H, W), or (H, W, 3) in RGB."""
        light = self._light[codes]
        if codes.ndim == 2:
            return self.path.radiance(light)
        images = [self.path.radiance(light[..., colour]) for colour in range(3)]
        channels = range(self.path.channels)
        return np.stack([images[channel][..., channel] for channel in channels], axis=-1)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests."""
        numbers = self.camera.describe()
        del numbers["exposures"]  # set by the driver
        return {
            "scene": self.path.describe(),
            "camera": numbers,
            "light_of_code": fingerprint(self._light),
            "seed": self._seed,
            **({} if self._knock is None else {"knock": list(self._knock)}),
        }

    def _lit(self) -> Codes:
        """Return the codes that are lit now, after the delay and the shift of a knock."""
        drawn, lit_since = tuple(self._drawn), time.monotonic() - self._delay
        lit = (codes for drawn_at, codes in drawn[::-1] if drawn_at <= lit_since)
        codes = next(lit, drawn[0][1] if drawn else self.codes)
        if self._knock is None or self._number <= self._knock[0]:
            return codes
        from scipy.ndimage import shift

        moved: Codes = shift(codes, (*self._knock[1:], 0)[: codes.ndim], order=0)
        return moved


class BenchProjector(WindowProjector):
    """The window projector, drawing into a `BenchScene`.

    In sequences it calls `trigger` of the bench's camera; None: it has no sequences.
    """

    def __init__(self, bench_scene: BenchScene, **settings: Any) -> None:
        self.bench_scene = bench_scene
        super().__init__(**settings)
        self.trigger: Callable[[], None] | None = None
        self._loaded: list[Float] = []

    def _open(self) -> BenchScene:
        return self.bench_scene

    @property
    def sequence_pictures(self) -> int:
        """Maximum number of pictures in a sequence, typical of a device; 0 without a trigger."""
        return 400 if self.trigger is not None else 0

    def load(self, pictures: Iterable[Float]) -> None:
        """Load the pictures of a sequence; see `rfpipe.rigs.devices.SequenceProjector`."""
        self._loaded = [check_picture(picture, self.shape) for picture in pictures]

    def play(self, order: Sequence[int], seconds: float) -> None:  # noqa: ARG002
        """Show a sequence; exposures are simulated, so `seconds` is ignored."""
        assert self.trigger is not None
        for place in order:
            self.show_now(self._loaded[place])
            self.trigger()


class PylonBenchCamera(PylonCamera):
    """Pylon's emulated camera on the bench, which reads its pictures from files.

    Exposures are those of `sensor`; noise, serial number and frame shape are the bench's.
    """

    kind = "bench"

    def __init__(self, bench_scene: BenchScene, sensor: CameraModel, **options: Any) -> None:
        os.environ.setdefault("PYLON_CAMEMU", "1")  # read when pylon is loaded
        self._scenery = bench_scene
        folder = mkdtemp(prefix="rfpipe-bench-")
        self._remove = finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._folder = Path(folder)
        pictures = self._folder / "pictures"
        pictures.mkdir()
        self._put(np.zeros(bench_scene.path.camera_shape, np.uint16), bench_scene.camera.bits)
        overrides = {
            "serial": "0815-0000",  # pylon's first emulated camera
            "shape": bench_scene.path.camera_shape,
            "nodes": {
                "TestImageSelector": "Off", "ImageFilename": str(pictures), "ImageFileMode": "On",
            },
        }  # fmt: skip
        try:
            super().__init__(sensor, **{**options, **overrides})
        except CaptureError as error:
            raise CaptureError(
                f"{error}. The bench needs pylon's emulated camera: set PYLON_CAMEMU=1 in the "
                "environment before pypylon is loaded"
            ) from error

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return super().describe() | {"nodes": {}} | self._scenery.describe()

    def close(self) -> None:
        """Give the camera back; closing twice is no error."""
        super().close()
        self._remove()

    def trigger(self) -> None:
        """Take a frame while armed, as the signal of a projector would."""
        if self._armed is not None and self._is_ready(self._options.timeout_seconds):
            self._before_trigger(self._armed[0])
            self._trigger()

    def _before_trigger(self, exposure: float) -> None:
        self._put(self._scenery.frame(exposure), self._scenery.camera.bits)

    def _put(self, counts: Counts, bits: int) -> None:
        """Write the camera's next picture to two files, since it reads a single file only once."""
        import cv2

        path, link = self._folder / "next.png", self._folder / "link.png"
        full_range = counts << np.uint16(16 - bits)
        if not cv2.imwrite(str(path), full_range, [cv2.IMWRITE_PNG_COMPRESSION, 0]):
            raise CaptureError(
                f"{path}: can't be written; check that the disk of {path.parent} isn't full"
            )
        os.link(path, link)
        link.replace(self._folder / "pictures" / "a.png")
        path.replace(self._folder / "pictures" / "b.png")


def software_bench(config: RigConfig) -> tuple[BenchProjector, Camera]:
    """Return the projector and the camera of a rig's bench; CaptureError without pylon."""
    bench = config.bench
    assert bench is not None
    true = sensor_from_config(bench.camera or config.sensor)
    assert isinstance(true, CameraModel)
    codes = np.linspace(0, 1, 256) ** bench.projector_gamma
    light = bench.projector_black + (1 - bench.projector_black) * codes
    bench_scene = BenchScene(
        optical_path(bench),
        light.astype(np.float32),
        true,
        config.seed,
        bench.display_delay_seconds,
        bench.knock,
    )
    response = calibration_of(config).projector_response
    projector = BenchProjector(bench_scene, response=response, **dict(config.projector.options))
    camera = PylonBenchCamera(bench_scene, sensor_of(config), **dict(config.camera.options))
    if camera.can_be_triggered:
        projector.trigger = camera.trigger
    return projector, camera
